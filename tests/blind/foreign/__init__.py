"""A second blind examiner: machines, effects and plans of other forms than those of `tests.blind`.

It shares the recording format, its writer and the nameplate's class with the first, and no form of any effect.
"""
