"""A small room, seen from known poses."""

import pytest

from tests.fusion.rooms import poses_in_room, room_view


@pytest.fixture(scope="session")
def rendered():
    """Twelve poses, each with the depth, the frame and the camera."""
    return [(pose, room_view(pose, 90, 120)) for pose in poses_in_room(12)]
