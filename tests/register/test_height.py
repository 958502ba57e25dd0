"""The surface: triangulated points and the spline under them."""

import json
from pathlib import Path

import numpy as np
import plate
import pytest
from register_session import Session

from kinran.base.exr import read_exr_with_header
from kinran.base.files import InputError
from kinran.register import cameras, height
from kinran.register.rectify import Grid


def true_height(grid: Grid) -> np.ndarray:
    return plate.height(*np.meshgrid(grid.x, grid.y))


def grid_in(folder: Path) -> Grid:
    report, picture = json.loads((folder / "register.json").read_text()), read_exr_with_header(folder / "height.exr")[0]
    rows, columns = picture["height"].shape
    return Grid(columns, rows, report["texel_mm"])


def test_height_is_found(registered: Path) -> None:
    """To 0.02 mm rms and 0.05 mm at p95, of 1.8 mm; row 0 is v = 0."""
    grid = grid_in(registered)
    channels, header = read_exr_with_header(registered / "height.exr")
    truth = true_height(grid)
    error = np.abs(channels["height"] - truth)
    assert np.sqrt((error**2).mean()) < 0.02
    assert np.percentile(error, 95) < 0.05
    assert np.abs(channels["height"][::-1] - truth).mean() > 10 * error.mean()
    assert np.abs(channels["height"][:, ::-1] - truth).mean() > 10 * error.mean()
    assert header["kinran:units"] == "mm"
    assert float(str(header["kinran:texel_mm"])) == pytest.approx(grid.texel)


def simulated_points(n: int, noise: float, lost: float) -> height.Points:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-20, 20, (2, n))
    z = plate.height(x, y) + noise * rng.normal(size=n)
    z[: int(lost * n)] += rng.uniform(-3, 3, int(lost * n))
    return height.Points(np.stack([x, y, z], -1), np.full(n, 0.05), np.full(n, 4))


def test_surface_forgets_wrong_points() -> None:
    """One point in ten is wrong by up to 3 mm: least squares follow them, the robust surface does not."""
    grid, points = Grid(200, 200, 0.2), simulated_points(3000, 0.01, 0.1)
    robust = height.fit(points, grid).on(grid) - true_height(grid)
    clean = height.fit(simulated_points(3000, 0.01, 0.0), grid).on(grid) - true_height(grid)
    assert robust.std() < 0.02
    assert robust.std() < 3 * clean.std()


@pytest.mark.parametrize(("doubt", "least", "most"), [(0.01, 0.0, 0.01), (height.DOUBT, 0.09, 0.15)])
def test_small_motifs_are_no_outliers(monkeypatch: pytest.MonkeyPatch, doubt: float, least: float, most: float) -> None:
    """Dots of 2 mm, 0.15 mm high: a scale that is taken from the spread of the points alone forgets them."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-20, 20, (2, 3000))
    z = plate.height(x, y) + 0.15 * (np.hypot((x + 3) % 6 - 3, (y + 3) % 6 - 3) < 1) + 0.005 * rng.normal(size=3000)
    monkeypatch.setattr(height, "DOUBT", doubt)
    grid = Grid(400, 400, 0.1)
    points = height.Points(np.stack([x, y, z], -1), np.full(3000, 0.07), np.full(3000, 4))
    raised = height.fit(points, grid).on(grid) - true_height(grid)
    columns, rows = np.meshgrid(grid.x, grid.y)
    on_top = np.hypot((columns + 3) % 6 - 3, (rows + 3) % 6 - 3) < 0.5
    assert least <= raised[on_top].mean() < most


def test_spline_is_the_same_on_a_grid_and_at_points() -> None:
    grid = Grid(50, 30, 0.8)
    spline = height.fit(simulated_points(2000, 0.01, 0.0), grid)
    x, y = np.meshgrid(grid.x, grid.y)
    np.testing.assert_allclose(spline.at(np.stack([x.ravel(), y.ravel()], -1)), spline.on(grid).ravel(), atol=1e-12)


def true_cameras(views: list[plate.View]) -> cameras.Cameras:
    return cameras.Cameras(
        plate.WIDTH,
        plate.HEIGHT,
        np.array([plate.FOCAL, plate.FOCAL, plate.LENS[0, 2], plate.LENS[1, 2], *plate.BROWN]),
        tuple(view.name for view in views),
        np.stack([view.rotation for view in views]),
        np.stack([view.translation for view in views]),
    )


@pytest.fixture(scope="module")
def exact(session: Session) -> cameras.Cameras:
    return true_cameras(session.views)


def test_rays_that_meet_are_triangulated(exact: cameras.Cameras) -> None:
    """One ray of six is wrong by a millimetre and does not count; a feature that two views see is not believed."""
    rng = np.random.default_rng(6)
    truth = np.c_[rng.uniform(-20, 20, (40, 2)), rng.uniform(-1, 2, 40)]
    centres = exact.centres
    away = truth[:, None] - centres
    positions = centres + away * (-centres[:, 2] / away[..., 2])[..., None]  # where the rays cross the plane
    positions[:, 2, 1] += 1.0
    seen = np.ones(positions.shape[:2], bool)
    seen[30:, 2:] = False
    points = height.triangulate(exact, positions, seen)
    assert len(points.xyz) == 30
    np.testing.assert_allclose(points.xyz, truth[:30], atol=0.01)
    assert (points.sigma > 0).all()


def test_fabric_without_texture(session: Session, exact: cameras.Cameras) -> None:
    blank = [np.full(picture.shape, 0.4, np.float32) for picture in session.pictures]
    with pytest.raises(InputError, match="only 0 points of the fabric are found in common"):
        height.measure(exact, blank, Grid(200, 200, 0.2))


def test_raised_motifs_are_followed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Floats 0.15 mm above the ground, a few mm wide, are 0.26 mm of shift at 60°; under 0.04 mm stay on average."""
    rng = np.random.default_rng(8)
    layers = plate.texture(rng)
    smooth = plate.height

    def raised(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        wave = np.sin(2 * np.pi * x / 7) * np.sin(2 * np.pi * (y + 0.2 * x) / 9)
        inside = (np.abs(x) < 22) & (np.abs(y) < 22)
        return smooth(x, y) + 0.15 * inside / (1 + np.exp(-(wave - 0.5) / 0.05))

    monkeypatch.setattr(plate, "height", raised)
    pictures = [plate.photograph(view, layers, rng).astype(np.float32) / 255 for view in session.views]
    found, grid = true_cameras(session.views), Grid(240, 240, 0.1)
    surface = height.measure(found, pictures, grid).height
    x, y = np.meshgrid(grid.x, grid.y)
    motif = raised(x, y) - smooth(x, y) > 0.14
    error = np.abs(surface - raised(x, y)) * np.tan(np.radians(60))
    assert error.mean() < 0.04
    assert np.abs(surface - smooth(x, y))[motif].mean() > 0.11
