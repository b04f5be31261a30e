"""From the flux map to the drive: current references, current control, compensation, sensorless limits, and their C code.

Knows maps, models and limits; nothing of recordings' samples nor of drives.
"""
