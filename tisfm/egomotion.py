"""The camera's motion from a flow field: `tisfm.motion.egomotion`'s, by a short name."""

from tisfm.motion.egomotion import CameraMotion, camera_motion

__all__ = ["CameraMotion", "camera_motion"]
