"""The camera's motion from a flow field: a short name for `tisfm.motion.egomotion`."""

from tisfm.motion.egomotion import CameraMotion, camera_motion

__all__ = ["CameraMotion", "camera_motion"]
