"""The wall of registration's tests, for all tests here."""

from tests.unit.registration.wall_scene import detections_of, wall

__all__ = ["detections_of", "wall"]
