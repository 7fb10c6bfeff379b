"""Photographs: frames so far apart that no track leads from one to the next."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tisfm.camera import Camera
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View, ViewSelection


def are_photographs(observations: Sequence[Observations]) -> bool:
    """Return whether most neighbouring frames share hardly any track.

    Frames without tracks, such as dark ones, are left out.
    """
    is_broken = [
        len(first.common_tracks(second)[0]) < TRACKS.min_matches
        for first, second in pairwise(observations)
        if min(len(first.tracks), len(second.tracks)) >= TRACKS.min_matches
    ]
    return bool(is_broken) and float(np.mean(is_broken)) >= TRACKS.min_photograph_share


def match_photographs(
    tracks: SequenceTracks,
    # frame number → (H, W) uint8, and (H, W) bool or None: pixels without points
    frame_of: Callable[[int], tuple[np.ndarray, np.ndarray | None]],
    camera: Camera,  # pinhole camera of the frames
    *,
    is_focal_known: bool,  # as for `SequenceTracker`
) -> SequenceTracks | None:  # None if frames match no others, or hardly move
    """Return the tracks of photographs: many points of all frames, matched by appearance.

    Every frame becomes a view. Matches become tracks, too: they give points and the first depth.
    """
    selection = ViewSelection(
        camera, is_focal_known=is_focal_known, on_disk=True, has_photographs=True
    )
    for frame, tracked in enumerate(tracks.observations):
        grey, ignored = frame_of(frame)
        selection.add(frame, grey, tracked, ignored)
    selection.close_loops(tracks.shape)
    matched = {frame for pair in selection.matches for frame in pair}
    if len(matched) < TRACKS.min_matched_share * len(selection.views):
        return None
    motions = [
        np.hypot(*(selection.views[k].detected[to] - selection.views[i].detected[at]).T)
        for (i, k), (at, to) in ((pair, found.T) for pair, found in selection.matches.items())
        if k == i + 1
    ]
    min_motion = TRACKS.min_photograph_motion * max(tracks.shape)
    if not motions or np.median(np.concatenate(motions)) < min_motion:
        return None
    observations = _add_matched_tracks(tracks.observations, selection.views, selection.matches)
    views = [replace(view, observations=observations[view.frame]) for view in selection.views]
    return replace(tracks, observations=observations, views=views, matches=selection.matches)


def _add_matched_tracks(
    observations: Sequence[Observations],
    views: Sequence[View],  # one for each frame
    matches: Mapping[tuple[int, int], np.ndarray],  # as of `SequenceTracks`
) -> list[Observations]:
    """Return the tracks of frames, with new tracks of points that match.

    A new track contains the points that matches join. It is left out if it has two points in one
    frame.
    """
    if not matches:
        return list(observations)
    counts = [len(view.detected) for view in views]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    joined = np.vstack(
        [pairs + offsets[list(views_of_pair)] for views_of_pair, pairs in matches.items()]
    )
    graph = coo_array((np.ones(len(joined)), joined.T), shape=(offsets[-1], offsets[-1]))
    _, track = connected_components(graph, directed=False)
    frame = np.repeat(np.arange(len(views)), counts)
    sizes = np.bincount(track)  # points
    frame_counts = np.bincount(np.unique(np.stack([track, frame]), axis=1)[0])
    is_track = (sizes > 1) & (sizes == frame_counts)
    first_new = 1 + max((int(o.tracks.max(initial=-1)) for o in observations), default=-1)
    numbers = first_new + np.cumsum(is_track) - 1
    result = []
    for index, (view, old) in enumerate(zip(views, observations, strict=True)):
        own = track[offsets[index] : offsets[index + 1]]
        is_used = is_track[own]
        points, new = view.detected[is_used], numbers[own[is_used]]
        order = np.argsort(new)
        result.append(
            Observations(
                points=np.vstack([old.points, points[order]]),
                tracks=np.concatenate([old.tracks, new[order]]),
            )
        )
    return result
