"""Orders in which an arm visits directions quickly, with monitors on its way, and the bound that no order undercuts.

An order is looked for among serpentines and rasters, which are optimal for grids, and tours of nearest neighbours that
2-opt and Or-opt shorten, which are good for any directions. All times are those of the rig's axes.
"""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.capture.arms import Pose, pose_of, shots_time
from kinran.data.capture_plan import Shot
from kinran.rig.errors import LimitError
from kinran.rig.motion import AXES, SETTLE_S, Axis, approach, move_time

Order = NDArray[np.intp]
Seconds = NDArray[np.float64]

PLACE_S = 0.02
"""Seconds of detour that a monitor is worth for each shot by which it stands nearer to its even share: a choice, by
which the monitors of a group of 64 are spread where that costs a second, and kept together where it costs a trip."""
EVEN_S = 100.0
"""The same where monitors alone follow the lamp: they stand at their even shares, whatever the trips to θ = 0 cost."""
STARTS = 6
"""Directions from which tours of nearest neighbours begin: more of them gain less than 1 % on random lists."""
LONGEST_RUN = 3
"""Most neighbours that Or-opt moves together (Or, 1976)."""
FIXED_S = -1e6
"""Cost of an edge that a tour must keep."""
NO_GAIN_S = 1e-6
"""Seconds that are no gain: above rounding, so that no change of a tour is undone by the next."""


def travel_time(poses: Sequence[Pose], axes: Sequence[Axis] = AXES, backlash: int = 0) -> float:
    """Return the seconds of all moves from the first pose to the last, in which no pose on the way is exposed.

    Parameters
    ----------
    poses
        Poses in millidegrees.
    axes
        Axes of the rig.
    backlash
        Backlash in millidegrees; each pose that `approach` puts in counts with its rest.
    """
    if not backlash:
        return sum(move_time(a, b, axes) for a, b in itertools.pairwise(poses))
    total = 0.0
    for start, target in itertools.pairwise(poses):
        way = [start, *approach(start, target, backlash, axes)]
        total += sum(move_time(a, b, axes) for a, b in itertools.pairwise(way)) + SETTLE_S * (len(way) - 2)
    return total


def move_times(starts: ArrayLike, ends: ArrayLike, axes: Sequence[Axis] = AXES) -> Seconds:
    """Return `move_time` of every pair of poses (n, axis) and (m, axis), as (n, m) seconds."""
    distances = np.abs(np.asarray(starts, float)[:, None] - np.asarray(ends, float)[None])
    used = axes[: distances.shape[2]]
    speed, acceleration = (np.array([[a.speed, a.acceleration] for a in used], float).T)[:, None, None]
    short = 2 * np.sqrt(distances / acceleration)
    long = distances / speed + speed / acceleration
    return np.asarray(np.where(distances <= speed**2 / acceleration, short, long).max(-1))


def spanning_time(poses: Sequence[Pose], axes: Sequence[Axis] = AXES) -> float:
    """Return the seconds of the minimum spanning tree of poses (Prim, 1957): no order of them takes less time."""
    left = np.array(sorted(set(poses)), float)
    at, left = left[:1], left[1:]
    nearest, total = move_times(at, left, axes)[0], 0.0
    while len(left):
        k = int(nearest.argmin())
        total += float(nearest[k])
        at, keep = left[k : k + 1], np.arange(len(left)) != k
        left = left[keep]
        nearest = np.minimum(nearest[keep], move_times(at, left, axes)[0])
    return total


def order_group(
    start: Pose,
    poses: Sequence[Pose],
    monitors: int,
    axes: Sequence[Axis] = AXES,
    backlash: int = 0,
    place_s: float = PLACE_S,
) -> list[tuple[int | None, Pose]]:
    """Return the order of a group's lights, with monitors at θ = 0 in it.

    The light arm comes from `start`, so that an order may begin at θ = 0 or end there, whichever is nearer. Groups that
    are ordered one after the other thus go up and down in turn.

    Parameters
    ----------
    start
        Pose before the group, in millidegrees.
    poses
        Poses (θ, φ) of the lights.
    monitors
        Number of monitors. Their φ is free, and is that of a neighbour.
    axes, backlash
        As in `travel_time`.
    place_s
        Seconds of detour that a monitor is worth for each shot by which it stands nearer to its even share.

    Returns
    -------
    list
        For each shot the index of its light, None for a monitor, and its pose.
    """
    found: list[tuple[float, int, list[tuple[int | None, Pose]]]] = []
    for candidates in (_rows(np.array(poses)), _tours(start, poses, bool(monitors), axes)):
        for order in candidates:
            shots: list[tuple[int | None, Pose]] = [(int(i), poses[i]) for i in order]
            for gap, phi in reversed(_monitor_places(start, [poses[i] for i in order], monitors, axes, place_s)):
                shots.insert(gap, (None, (0, phi)))
            seconds = travel_time([start, *(pose for _, pose in shots)], axes, backlash)
            found.append((round(seconds, 6), len(found), shots))
        seconds, _, best = min(found)
        if seconds < spanning_time([start, *(pose for _, pose in best)], axes) + NO_GAIN_S:
            break
    return best


def reorder(start: Sequence[int], shots: Sequence[Shot], axes: Sequence[Axis] = AXES) -> list[Shot]:
    """Return the shots that are missing of a group in a quick order.

    A first or last shot that is a monitor stays first or last, and other monitors stand where they cost least. Shots
    of another subject than the fabric under the light arm (dark, white, chart, side views) keep their order.

    Parameters
    ----------
    start
        Pose in which the rig stands, in millidegrees.
    shots
        Missing shots in the order of the plan.
    axes
        Axes of the rig.
    """
    if len(shots) < 2 or any(shot.kind not in ("light", "monitor") for shot in shots):
        return list(shots)
    poses = [(int(start[0]), int(start[1])), *(pose_of(shot) for shot in shots)]
    fixed = [0] + [k for k, shot in ((1, shots[0]), (len(shots), shots[-1])) if shot.kind == "monitor"]
    first = [k for k in fixed if k < 2]
    last = [k for k in fixed if k > 1]
    times = move_times(poses, poses, axes)
    free = np.setdiff1d(np.arange(len(poses)), [*first, *last])
    given = np.arange(len(poses))
    tours = [given, _joined(first, free[::-1], last), _joined(first, _nearest(times, first[-1], free), last)]
    tours += [improved(tour, times, len(first), len(last)) for tour in tours]
    spent = [round(float(times[tour[:-1], tour[1:]].sum()), 6) for tour in tours]
    return [shots[k - 1] for k in tours[int(np.argmin(spent))][1:]]


def order_views(views: Sequence[Shot], axes: Sequence[Axis] = AXES) -> list[Shot]:
    """Return the front view, which is the first, and the side views in an order in which the arms keep clear."""
    times = np.zeros((len(views), len(views)))
    for i, j in itertools.combinations(range(len(views)), 2):
        try:
            times[i, j] = times[j, i] = shots_time([views[i], views[j]], axes)
        except LimitError:
            times[i, j] = times[j, i] = -FIXED_S / len(views) ** 2  # dearer than any order that keeps clear
    tour = _joined([0], _nearest(times, 0, np.arange(1, len(views))), [])
    return [views[k] for k in improved(tour, times, first=1)]


def improved(order: Order, times: Seconds, first: int = 0, last: int = 0) -> Order:
    """Return an order that no 2-opt and no Or-opt step shortens (Croes, 1958; Or, 1976).

    Parameters
    ----------
    order
        Order of the indices of `times`.
    times
        Symmetric seconds (n, n) between two poses.
    first, last
        Number of poses at its beginning and at its end that keep their places; others may end up anywhere.
    """
    n = len(times)
    cost = np.zeros((n + 1, n + 1))  # the open order is a closed tour through a pose that is near to all
    cost[:n, :n] = times
    tour = np.array([n, *order])
    for a, b in [*itertools.pairwise(tour[: first + 1]), *itertools.pairwise([*tour, n][len(tour) - last :])]:
        cost[a, b] = cost[b, a] = FIXED_S
    while (better := _two_opt(tour, cost)) is not None or (better := _or_opt(tour, cost)) is not None:
        tour = better
    return tour[1:]


def _two_opt(tour: Order, cost: Seconds) -> Order | None:
    """Return a tour with the run reversed that gains most; None if none gains."""
    here, after = cost[np.ix_(tour, tour)], np.roll(tour, -1)
    edges = cost[tour, after]
    change = here + cost[np.ix_(after, after)] - edges[:, None] - edges[None]
    change[np.tril_indices(len(tour), 1)] = 0
    i, j = np.unravel_index(int(change.argmin()), change.shape)
    if change[i, j] > -NO_GAIN_S:
        return None
    return np.concatenate([tour[: i + 1], tour[i + 1 : j + 1][::-1], tour[j + 1 :]])


def _or_opt(tour: Order, cost: Seconds) -> Order | None:
    """Return a tour with a short run moved to where it gains most, either way round; None if none gains."""
    n, best, found = len(tour), -NO_GAIN_S, None
    after = np.roll(tour, -1)
    edges = cost[tour, after]
    for length in range(1, min(LONGEST_RUN, n - 3) + 1):
        head = np.arange(1, n - length + 1)  # place 0 is the end that stays
        tail = head + length - 1
        a, b = tour[head], tour[tail]
        gain = edges[head - 1] + edges[tail] - cost[tour[head - 1], after[tail]]
        for turned, (enter, leave) in enumerate(((a, b), (b, a))):
            change = cost[np.ix_(enter, tour)] + cost[np.ix_(leave, after)] - edges[None] - gain[:, None]
            places = np.arange(n)[None]
            change[(places >= head[:, None] - 1) & (places <= tail[:, None])] = 0
            k, j = np.unravel_index(int(change.argmin()), change.shape)
            if change[k, j] < best:
                best, found = float(change[k, j]), (int(head[k]), length, int(j), turned)
    if found is None:
        return None
    head_at, length, place, turned = found
    run = tour[head_at : head_at + length][:: -1 if turned else 1]
    rest = np.delete(tour, np.s_[head_at : head_at + length])
    return np.insert(rest, (place if place < head_at else place - length) + 1, run)


def _tours(start: Pose, poses: Sequence[Pose], to_pole: bool, axes: Sequence[Axis]) -> Iterator[Order]:
    """Yield orders of a group's lights that pass θ = 0 well: improved rows, and tours of nearest neighbours."""
    every = [start, *poses, *([(0, start[1])] if to_pole else [])]
    times = move_times(every, every, axes)
    if to_pole:  # its φ is free
        times[-1] = times[:, -1] = move_times([(0,)], [pose[:1] for pose in every], axes)[0]
    n = len(poses)
    lights, rows = np.arange(1, n + 1), [row + 1 for row in _rows(np.array(poses))]
    spent = [float(times[[0, *row[:-1]], row].sum()) for row in rows]
    tours = [_joined([0], rows[int(np.argmin(spent))], [n + 1] if to_pole else [])]
    for begin in np.unique(np.linspace(1, n, STARTS).round().astype(int)):
        others = np.append(np.setdiff1d(lights, [begin]), [n + 1] if to_pole else []).astype(np.intp)
        tours.append(_joined([0, begin], _nearest(times, int(begin), others), []))
    for tour in tours:
        order = improved(tour, times, first=1)
        order = order[(order > 0) & (order <= n)] - 1
        yield order
        yield order[::-1]


def _rows(poses: NDArray[np.int_]) -> Iterator[Order]:
    """Yield orders in rows of an equal angle, all the same way (raster) or every second backwards (serpentine)."""
    for inner, outer in ((1, 0), (0, 1)):
        for turned, outward, along in itertools.product((False, True), (1, -1), (1, -1)):
            _, row = np.unique(outward * poses[:, outer], return_inverse=True)
            sign = np.where(turned & (row % 2 == 1), -along, along)
            yield np.lexsort((sign * poses[:, inner], row))


def _nearest(times: Seconds, start: int, others: Order) -> Order:
    """Return the tour from `start`, left out, that always goes to the nearest of the poses that are left."""
    tour, left = [start], [int(k) for k in others]
    while left:
        tour.append(left.pop(int(np.argmin(times[tour[-1], left]))))
    return np.array(tour[1:], np.intp)


def _joined(first: Sequence[int], middle: Order, last: Sequence[int]) -> Order:
    return np.concatenate([np.array(first, np.intp), middle, np.array(last, np.intp)])


def _monitor_places(
    start: Pose, lights: list[Pose], count: int, axes: Sequence[Axis], place_s: float
) -> list[tuple[int, int]]:
    """Return the place in an order of lights and the φ of each monitor.

    The sum of all detours, and of `place_s` for each shot between a monitor and its even share, is the least. The
    first monitor at a place costs the detour, others at that place nothing.
    """
    if not count:
        return []
    n, here = len(lights), [start, *lights]
    to_pole = move_times(here, [(0, pose[1]) for pose in here], axes)  # [k, m]: from pose k to θ = 0 at the φ of pose m
    before, after = np.arange(n), np.arange(1, n + 1)
    direct = [move_time(a, b, axes) for a, b in itertools.pairwise(here)]
    at_before = to_pole[before, before] + to_pole[after, before] - direct
    at_after = to_pole[before, after] + to_pole[after, after] - direct
    detour = np.append(np.minimum(at_before, at_after), to_pole[n, n])
    shares = np.linspace(0, n, count)[:, None] if count > 1 else np.zeros((1, 1))
    away = place_s * np.abs(np.arange(n + 1) - shares)
    spent, back = detour + away[0], []
    for k in range(1, count):
        least = np.minimum.accumulate(spent)
        new = np.append(np.inf, least[:-1]) + detour  # at a later place than the one before
        place = np.maximum.accumulate(np.where(spent <= least, np.arange(n + 1), 0))
        stays = spent <= new
        back.append(np.where(stays, np.arange(n + 1), np.append(0, place[:-1])))
        spent = np.where(stays, spent, new) + away[k]
    places = [int(spent.argmin())]
    for came in reversed(back):
        places.insert(0, int(came[places[0]]))
    return [(gap, here[gap if gap == n or at_before[gap] <= at_after[gap] else gap + 1][1]) for gap in places]
