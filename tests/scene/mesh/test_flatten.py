import numpy as np
import pytest

from kinran.scene.flatten import (
    boundary_loops,
    hang,
    quarter_turns,
    side_angles,
    stretch,
    turn_to_weft,
    unwrap,
    vector_area,
    vertex_normals,
)
from kinran.virtual.scan import drape


def grid(width: float, height: float, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Flat sheet: uv (n, 2) and faces (m, 3), counter-clockwise."""
    u, v = np.meshgrid(np.arange(0, width + 1e-9, pitch), np.arange(0, height + 1e-9, pitch))
    i = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    return np.stack([u, v], -1).reshape(-1, 2), np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def turned(uv: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return uv @ np.array([[c, s], [-s, c]])


def ragged_outline(rng: np.random.Generator) -> np.ndarray:
    """Points every 0.5 mm around 60 × 90 mm, each up to 0.4 mm inside."""
    u, v = np.arange(0, 60, 0.5), np.arange(0, 90, 0.5)
    inside = [rng.uniform(0, 0.4, len(x)) for x in (u, u, v, v)]
    sides = [(u, inside[0]), (u, 90 - inside[1]), (inside[2], v), (60 - inside[3], v)]
    return np.concatenate([np.stack(side, -1) for side in sides])


@pytest.mark.parametrize("degrees", [0, 17, 44.9, 46, 89, 133, -71])
def test_weft_of_a_ragged_turned_panel(degrees: float) -> None:
    """Within 0.1° of the truth, up to the half turn that an outline cannot tell."""
    rng = np.random.default_rng(0)
    outline = ragged_outline(rng)
    uv, residuals = turn_to_weft(turned(outline, degrees), np.arange(len(outline)))
    assert np.abs(np.degrees(residuals)).max() < 0.3
    assert uv.max(0) == pytest.approx([60, 90], abs=0.2)
    away = min(np.abs(uv - q).max() for q in (outline - outline.min(0), outline.max(0) - outline))
    assert away < 90 * np.radians(0.1) + 0.2


def test_a_cut_corner_misleads_the_rectangle_but_not_the_sides() -> None:
    """A dart of 25 × 8 mm off the corner of an outline: the four fitted sides still say the weft to 0.2°.

    The minimum-area rectangle alone, which the sides start from, may lean on the cut.
    """
    rng = np.random.default_rng(1)
    outline = ragged_outline(rng)
    cut = outline[outline[:, 0] / 8 + outline[:, 1] / 25 > 1]
    angles, lengths = side_angles(turned(cut, 30))
    assert (np.diff(lengths) >= 0).all()
    weft = np.degrees(angles) - [30, 30, 120, 120]
    assert np.abs((weft + 90) % 180 - 90).max() < 0.2


def test_unwrap_gives_back_lengths_of_folded_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances of 2000 pairs in the chart, against arc length, on cloth without a bump: within 0.3 mm."""
    monkeypatch.setattr("kinran.virtual.scan.BUMP_HEIGHT", 0.0)
    flat, faces = grid(60, 90, 1.0)
    bumpless = drape(flat)
    chart = unwrap(bumpless, faces)
    mean, p99, flipped = stretch(bumpless, faces, chart)
    assert flipped == 0
    assert mean < 1.004
    assert p99 < 1.02
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(flat), (2, 2000))
    want, got = (np.linalg.norm(x[a] - x[b], axis=-1) for x in (flat, chart))
    assert np.abs(got - want).max() < 0.3


def test_unwrap_never_folds_where_conformal_maps_and_arap_do() -> None:
    """A deep, crumpled cup: ARAP from a conformal start folds faces over, the method used does not."""
    import igl

    flat, faces = grid(20, 20, 0.5)
    rng = np.random.default_rng(3)
    height = 60 * np.exp(-((flat - 10) ** 2).sum(-1) / 12)
    cup = np.column_stack([flat, height]) + rng.normal(0, 0.08, (len(flat), 3))
    loop = igl.boundary_loop(faces)
    pins = np.array([loop[0], loop[len(loop) // 2]])
    start = igl.lscm(cup, faces, pins, np.array([[0.0, 0.0], [20.0, 0.0]]))[0]
    data = igl.ARAPData()
    data.with_dynamics, data.max_iter = False, 40
    pin = np.array([len(cup) // 2])
    igl.arap_precomputation(cup, faces, 2, pin, data)
    arap = igl.arap_solve(np.ascontiguousarray(start[pin]), data, np.ascontiguousarray(start))
    flips = stretch(cup, faces, arap)[2]
    assert min(flips, len(faces) - flips) > 0  # the old failure
    assert stretch(cup, faces, unwrap(cup, faces))[2] == 0


def test_unwrap_is_right_handed_seen_from_the_front() -> None:
    flat, faces = grid(6, 9, 1.0)
    sheet = np.column_stack([flat, np.zeros(len(flat))])
    assert stretch(sheet, faces, unwrap(sheet, faces))[2] == 0
    back = faces[:, ::-1]  # the other side is the front now: the chart must be mirrored
    assert stretch(sheet, back, unwrap(sheet, back))[2] == 0
    assert stretch(sheet, back, unwrap(sheet, faces))[2] == len(faces)


def test_stretch_of_known_maps() -> None:
    flat, faces = grid(6, 9, 1.0)
    sheet = np.column_stack([flat, np.zeros(len(flat))])
    assert stretch(sheet, faces, flat) == pytest.approx((1, 1, 0))
    assert stretch(sheet, faces, flat * [1.25, 1])[:2] == pytest.approx((1.25, 1.25))
    assert stretch(sheet, faces, flat * [1, 0.5])[:2] == pytest.approx((2, 2))


def test_hang_is_a_rigid_motion_that_puts_warp_up_and_front_to_the_viewer() -> None:
    from scipy.spatial.transform import Rotation

    flat, faces = grid(60, 90, 2.0)
    pose = Rotation.from_rotvec([0.8, -1.9, 0.4])
    vertices = pose.apply(drape(flat)) + np.array([5, -70, 300])
    motion = hang(vertices, faces, flat)
    assert motion[:3, :3] @ motion[:3, :3].T == pytest.approx(np.eye(3))
    assert np.linalg.det(motion) == pytest.approx(1)
    hung = vertices @ motion[:3, :3].T + motion[:3, 3]
    assert hung.min(0) == pytest.approx(-hung.max(0))
    upright = drape(flat) - (drape(flat).min(0) + drape(flat).max(0)) / 2
    assert np.abs(hung - upright).max() < 3  # the mean warp and front lean a little on folded cloth
    assert vector_area(hung, faces)[2] > 0


def test_normals_and_loops_of_a_sheet_with_a_hole() -> None:
    flat, faces = grid(10, 10, 1.0)
    middle = flat[faces].mean(1)
    holed = faces[np.abs(middle - 5).max(-1) > 1]
    sheet = np.column_stack([flat, np.zeros(len(flat))])
    assert vertex_normals(sheet, faces) == pytest.approx(np.tile([0, 0, 1], (len(flat), 1)))
    assert [len(loop) for loop in boundary_loops(holed)] == [40, 8]
    assert boundary_loops(np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])) == []


def test_quarter_turns_keep_the_hand() -> None:
    flat, faces = grid(6, 9, 1.0)
    sheet = np.column_stack([flat, np.zeros(len(flat))])
    for turns in range(4):
        assert stretch(sheet, faces, quarter_turns(flat, turns)) == pytest.approx((1, 1, 0))
    assert quarter_turns(flat, 1).max(0) == pytest.approx([9, 6])
