"""The published estimators, rebuilt from their descriptions, to stand beside ours.

Each has ``pose(image)``, which returns ``(x, y, z, pitch, yaw)`` or raises `NoPose`.
"""
