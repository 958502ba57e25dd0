"""Cameras from a known target: one lens that all views share, and a pose for each, by bundle adjustment."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.base.frames import angles
from kinran.register.target import CENTRE, Corners

try:
    import pycolmap
except ModuleNotFoundError:
    raise InputError("the package pycolmap is missing, which registers views: pip install 'pycolmap>=4.2'") from None

Array = NDArray[np.float64]

VIEWS = 3
"""Fewest views that a lens is found from: two of a plane do not tell its parameters apart [Zhang2000]."""
TURN = np.radians(10)
"""Least angle between the two views that are furthest apart: nearer ones tell neither the focal length nor a height. No
measurement stands behind the angle."""
OUTLIER = 5.0
"""Reprojection error, in robust standard deviations and at least half a pixel, above which a corner is left out: that
takes one true corner in hundreds of thousands. Corners of a fixed refinement window were off by 2 px where the others
are at 0.2."""
LOST = 0.25
"""Share of a view's corners that may be left out before the view is not believed: glare on the plate takes some, a bent
plate or a wrong board all. No measurement stands behind the share."""


@dataclass(frozen=True)
class Cameras:
    """The views of a session, in board coordinates (mm), pixels with the first one's middle at (0.5, 0.5).

    Attributes
    ----------
    width, height
        Size of every picture in pixels.
    lens : (8,) float
        f_x, f_y, c_x, c_y in px, then Brown's k_1, k_2, p_1, p_2: the OPENCV model.
    names
        Names of the views; the first is the front view.
    rotations : (view, 3, 3) float
        Camera from board; camera x to the right, y down, z forward.
    translations : (view, 3) float
        Position of the board's middle before the camera, in mm.
    """

    width: int
    height: int
    lens: Array
    names: tuple[str, ...]
    rotations: Array
    translations: Array

    @property
    def centres(self) -> Array:
        """Positions (view, 3) of the cameras in mm."""
        return np.asarray(-np.einsum("nji,nj->ni", self.rotations, self.translations))

    def project(self, view: int, points: Array) -> Array:
        """Pixels (..., 2) of board points (..., 3)."""
        seen = points.reshape(-1, 3) @ self.rotations[view].T + self.translations[view]
        return np.asarray(self._camera().img_from_cam(seen)).reshape(*points.shape[:-1], 2)

    def rays(self, view: int, pixels: Array) -> Array:
        """Directions (..., 3), in board coordinates, from the view's centre through pixels (..., 2)."""
        normal = np.asarray(self._camera().cam_from_img(pixels.reshape(-1, 2)))
        rays = np.c_[normal, np.ones(len(normal))] @ self.rotations[view]
        return np.asarray(rays).reshape(*pixels.shape[:-1], 3)

    def pixel_mm(self, view: int) -> float:
        """Size of a pixel in the middle of the board, as seen face on, in mm."""
        return float(np.linalg.norm(self.centres[view]) / self.lens[:2].mean())

    def _camera(self) -> Any:
        return pycolmap.Camera(
            model="OPENCV", width=self.width, height=self.height, params=list(self.lens), camera_id=1
        )


@dataclass(frozen=True)
class JudgedCameras:
    """Cameras, and the goodness of their fit to the corners.

    Attributes
    ----------
    cameras
        The cameras, with the board taken as it is described.
    rms : (view,) float
        Reprojection error of the corners that were used, in px.
    used, left_out : (view,) int
        Numbers of corners that were used and left out.
    free_rms : (view,) float
        Reprojection error in px with the board's corners left free: a check, not the result.
    bend : (2,) float
        Rms distance in mm of the free corners from where they should be: in the plane, out of it.
    """

    cameras: Cameras
    rms: Array
    used: NDArray[np.int64]
    left_out: NDArray[np.int64]
    free_rms: Array
    bend: Array


def calibrate(points: Array, views: list[Corners], width: int, height: int) -> JudgedCameras:
    """Find the cameras of all views of a target.

    Parameters
    ----------
    points : (corner, 3) float
        The target's corners in mm.
    views
        Corners that each view shows.
    width, height
        Size of every picture in pixels.

    Raises
    ------
    InputError
        There are too few views, all look from one place, or the corners of a view do not fit any pose.
    """
    if len(views) < VIEWS:
        raise InputError(f"{len(views)} views: a lens needs at least {VIEWS}; add side views")
    start = initial(points, views, width, height)
    _check_turn(start)
    cameras, _ = adjust(points, views, start)
    kept = trim(points, views, cameras)
    cameras, _ = adjust(points, kept, cameras)
    _check_turn(cameras)
    free, bent = adjust(points, kept, cameras, free_points=True)
    seen = np.isfinite(bent).all(1)
    shift = similarity(bent[seen], points[seen]) - points[seen]
    counts = np.array([len(view.ids) for view in kept])
    return JudgedCameras(
        cameras,
        rms(points, kept, cameras),
        counts,
        np.array([len(view.ids) for view in views]) - counts,
        rms(bent, kept, free),
        np.sqrt(np.array([(shift[:, :2] ** 2).sum(1).mean(), (shift[:, 2] ** 2).mean()])),
    )


def initial(points: Array, views: list[Corners], width: int, height: int) -> Cameras:
    """Cameras to start from: the focal length of the homographies [Zhang2000], no distortion, and a pose for each view.

    Raises
    ------
    InputError
        The corners of a view fit no pose.
    """
    flat = [points[view.ids].astype(np.float32) for view in views]
    found = [view.pixels.astype(np.float32) for view in views]
    matrix = cv2.initCameraMatrix2D(flat, found, (width, height))
    focal = float(np.mean([matrix[0, 0], matrix[1, 1]]))
    if not 0.3 * width < focal < 100 * width:
        focal = 1.2 * max(width, height)
    lens = np.array([focal, focal, width / 2, height / 2, 0, 0, 0, 0])
    cameras = Cameras(width, height, lens, tuple(v.name for v in views), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    pycolmap.set_random_seed(0)
    options = pycolmap.AbsolutePoseEstimationOptions(ransac=pycolmap.RANSACOptions(max_error=0.01 * width))
    poses = []
    for view in views:
        found_pose = pycolmap.estimate_and_refine_absolute_pose(
            view.pixels, points[view.ids], cameras._camera(), options
        )
        if found_pose is None:
            raise InputError(f"{view.name}: its corners fit no pose of the camera; check the board file")
        poses.append(found_pose["cam_from_world"])
    rotations = np.stack([pose.rotation.matrix() for pose in poses])
    return replace(cameras, rotations=rotations, translations=np.stack([pose.translation for pose in poses]))


def adjust(points: Array, views: list[Corners], start: Cameras, free_points: bool = False) -> tuple[Cameras, Array]:
    """Bundle adjustment: least squares of the reprojection errors over lens and poses.

    Errors are squared on purpose: a robust loss hides a view whose corners are wrong in a plausible solution.

    Parameters
    ----------
    points : (corner, 3) float
        Corners of the target in mm.
    views
        Corners that each view shows.
    start
        Cameras to start from.
    free_points
        Let the target's corners move as well, with the first cameras holding the frame.

    Returns
    -------
    cameras
        Adjusted cameras of the same views.
    points : (corner, 3) float
        Corners of the target in mm; NaN for those that no view shows.
    """
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(start._camera())
    number = {
        int(k): model.add_point3D(points[k], pycolmap.Track(), np.zeros(3, np.uint8))
        for k in np.unique(np.concatenate([view.ids for view in views]))
    }
    config = pycolmap.BundleAdjustmentConfig()
    for n, view in enumerate(views):
        image = pycolmap.Image(
            name=view.name,
            points2D=pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in view.pixels]),
            camera_id=1,
            image_id=n + 1,
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(start.rotations[n]), start.translations[n])
        model.add_image_with_trivial_frame(image, pose)
        for index, corner in enumerate(view.ids):
            model.add_observation(number[int(corner)], pycolmap.TrackElement(n + 1, index))
        config.add_image(n + 1)
    if free_points:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    else:
        for point in number.values():
            config.add_constant_point(point)
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=True,
        refine_principal_point=True,
        refine_extra_params=True,
        refine_points3D=free_points,
        print_summary=False,
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.TRIVIAL
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    poses = [model.image(n + 1).cam_from_world() for n in range(len(views))]
    moved = np.full(points.shape, np.nan)
    for corner, point in number.items():
        moved[corner] = model.point3D(point).xyz
    return replace(
        start,
        lens=np.array(model.camera(1).params, float),
        rotations=np.stack([pose.rotation.matrix() for pose in poses]),
        translations=np.stack([pose.translation for pose in poses]),
    ), moved


def misses(points: Array, views: list[Corners], cameras: Cameras) -> list[Array]:
    """Reprojection errors of each view's corners, (n, 2) in px."""
    return [cameras.project(n, points[view.ids]) - view.pixels for n, view in enumerate(views)]


def rms(points: Array, views: list[Corners], cameras: Cameras) -> Array:
    """Rms length of each view's reprojection errors in px; (view,)."""
    return np.array([np.sqrt((miss**2).sum(1).mean()) for miss in misses(points, views, cameras)])


def trim(points: Array, views: list[Corners], cameras: Cameras) -> list[Corners]:
    """Leave out the corners that miss grossly: a reflection on the plate, a marker taken for another.

    Raises
    ------
    InputError
        Too many corners of one view are wrong.
    """
    lengths = [np.linalg.norm(miss, axis=1) for miss in misses(points, views, cameras)]
    limit = max(0.5, OUTLIER * float(np.median(np.concatenate(lengths))) / 1.1774)  # median of a Rayleigh
    kept = []
    for view, length in zip(views, lengths, strict=True):
        good = length <= limit
        if good.mean() < 1 - LOST:
            raise InputError(
                f"{view.name}: {np.sum(~good)} of its {len(good)} corners miss by more than {limit:.1f} px; "
                "check that the plate is flat and whole in it, or leave the view out"
            )
        kept.append(Corners(view.name, view.ids[good], view.pixels[good]))
    return kept


def similarity(points: Array, targets: Array) -> Array:
    """Points (n, 3) after the rotation, scale and shift that bring them nearest to the targets [Umeyama1991].

    pycolmap's own estimate gives up on points in a plane.
    """
    p, q = points - points.mean(0), targets - targets.mean(0)
    u, d, vt = np.linalg.svd(q.T @ p)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (d * sign).sum() / (p**2).sum()
    return np.asarray(scale * p @ (u * sign @ vt).T + targets.mean(0))


def _check_turn(cameras: Cameras) -> None:
    towards = cameras.centres / np.linalg.norm(cameras.centres, axis=1, keepdims=True)
    turn = float(np.arccos(np.clip(towards @ towards.T, -1, 1)).max())
    if turn < TURN:
        raise InputError(
            f"{', '.join(cameras.names)}: all views look from one place, within {np.degrees(turn):.1f}°; "
            f"add side views at least {np.degrees(TURN):.0f}° away"
        )


def describe(result: JudgedCameras) -> dict[str, Any]:
    """Contents of `cameras.json`, with lengths in mm and angles in radians."""
    cameras = result.cameras
    theta, phi = angles(cameras.centres)
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
    return {
        "model": "OPENCV",
        "width": cameras.width,
        "height": cameras.height,
        "first_pixel_centre": [CENTRE, CENTRE],
        "frame": "X=+u=weft, Y=+v=warp, Z=view; mm from the middle of the board; camera x right, y down, z forward",
        "intrinsics": {name: float(value) for name, value in zip(names, cameras.lens, strict=True)},
        "rms_px": float(np.sqrt((result.rms**2 * result.used).sum() / result.used.sum())),
        "free_board": {
            "rms_px": float(np.sqrt((result.free_rms**2 * result.used).sum() / result.used.sum())),
            "bend_in_plane_mm": float(result.bend[0]),
            "bend_out_of_plane_mm": float(result.bend[1]),
        },
        "views": [
            {
                "name": name,
                "rotation": cameras.rotations[n].tolist(),
                "translation_mm": cameras.translations[n].tolist(),
                "centre_mm": cameras.centres[n].tolist(),
                "theta": float(theta[n]),
                "phi": float(phi[n]),
                "corners": int(result.used[n]),
                "corners_left_out": int(result.left_out[n]),
                "rms_px": float(result.rms[n]),
            }
            for n, name in enumerate(cameras.names)
        ],
    }
