"""The blind examiner: recordings with hidden effects of a plant of its own, and a score of what is stated about them.

It knows the diagnosis by its command line's JSON alone, and shares no code with it nor with the simulated drive.
"""
