"""The calibration of a capture: its camera, its lamp and its colours (`calibration.json`)."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, read_json, write_json
from kinran.data.flat_field import Flat

VERSION = 2
"""Version of the file's layout; another one is refused."""
MARGIN = 0.99
"""Share of the measured saturation from which counts are taken as saturated. A lower share costs noise (0.95: 6 % of
RMSE) and no bias; one that is 10 % too high biases by 4.8 % (on the synthetic camera of ``kinran bench merge``)."""


@dataclass(frozen=True)
class Response:
    """Response of a sensor: the counts that electrons become.

    Attributes
    ----------
    saturation
        Counts over black at which a site is full.
    gain
        Counts per electron.
    read
        Read noise: standard deviation of darkness in counts, rounding included.
    coding
        Standard deviation, relative to the signal, of the noise that a photograph's encoding adds: the steps of its
        codes, which grow with the light, and the losses of JPEG. 0 for RAW.
    """

    saturation: float
    gain: float
    read: float
    coding: float = 0.0

    @property
    def clip(self) -> float:
        """Counts over black from which on a site is taken as saturated."""
        return MARGIN * self.saturation


@dataclass(frozen=True)
class Exposure:
    """A calibrated shutter time.

    Attributes
    ----------
    nominal_s
        Time on the dial in seconds.
    prior_s
        Third stop in seconds that the nominal time stands for.
    seconds
        Measured time in seconds, where the longest is at its third stop.
    sites
        Number of sensor sites that it was measured on; 0 where none was fit, and `seconds` follows `prior_s`.
    curtain
        Legendre coefficients of degree 1, 2, … of the exposure over the rows, from the bottom up; none if even.
    """

    nominal_s: float
    prior_s: float
    seconds: float
    sites: int
    curtain: tuple[float, ...] = ()


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera whose response is known, under a lamp whose light is known.

    Attributes
    ----------
    black : (4,)
        Black level of R, G1, G2, B in counts, relative to the mean under the mask if `masked`; (3,) for photographs.
    masked
        Whether frames have a masked border, under which the black level of each is measured.
    response
        Saturation, gain and read noise.
    exposures
        Shutter times, longest first.
    bad : (plane, y, x)
        Hot and dead sites.
    white : (3,)
        Counts per second of R, G, B on the white plate at θ = 0, where π·T = 1.
    photodiode
        Reading of the lamp's photodiode while the white plate was shot; None where the rig has none.
    monitor
        Level of the fabric at θ = 0 (`calibrate.lamp.level`) in counts per second, under the lamp as it lit the white
        plate; None where it was not shot.
    flats
        Flat fields, one for each direction in which a white plate was shot.
    glare
        Veiling glare: share of a picture's mean light that lens and camera spread evenly over it.
    prnu
        Photo-response non-uniformity: relative standard deviation of the sites' responses.
    """

    black: tuple[float, ...]
    masked: bool
    response: Response
    exposures: tuple[Exposure, ...]
    bad: tuple[tuple[int, int, int], ...]
    white: tuple[float, float, float] = (1.0, 1.0, 1.0)
    photodiode: float | None = None
    monitor: float | None = None
    flats: tuple[Flat, ...] = ()
    glare: float = 0.0
    prnu: float = 0.0

    def exposure(self, nominal: float) -> Exposure:
        """Return the calibrated exposure of a nominal shutter time in seconds.

        Raises
        ------
        InputError
            The time was not calibrated.
        """
        for exposure in self.exposures:
            if abs(exposure.nominal_s - nominal) < 1e-3 * nominal:
                return exposure
        known = ", ".join(f"{exposure.nominal_s:g}" for exposure in self.exposures)
        raise InputError(f"exposure {nominal:g} s was not calibrated ({known} s were); shoot the calibration with it")


@dataclass(frozen=True)
class Patch:
    """A patch of the colour chart.

    Attributes
    ----------
    colour : (3,)
        Measured colour, freed of glare and transformed by the matrix: linear ACEScg under a white of 1.
    reference : (3,)
        Reference colour: linear ACEScg under a white of 1.
    delta_e
        Leave-one-out error: ΔE00 under the matrix that is fitted to the other patches.
    root_delta_e
        Leave-one-out error of the root polynomial (Finlayson2015).
    left_out
        Why the fits leave the patch out; empty where they use it.
    """

    colour: tuple[float, float, float]
    reference: tuple[float, float, float]
    delta_e: float
    root_delta_e: float
    left_out: str = ""


@dataclass(frozen=True)
class Calibration:
    """Calibration of a capture.

    Attributes
    ----------
    fabric, plan_sha256
        Fabric and plan that were calibrated.
    height, width
        Size of the stack in texels.
    encoding, crop
        Encoding and crop of photographs; empty for RAW frames.
    camera
        Camera; None for photographs.
    colour
        Name of the stack's RGB.
    to_acescg : (3, 3)
        Stack RGB (column) to linear ACEScg.
    delta_e
        Leave-one-out ΔE00 of the chart's patches that are used; empty for photographs without a chart.
    patches
        Indices of these among the 24 patches; the others were saturated, hidden or outliers.
    root_polynomial : (3, 6)
        Root polynomial from stack RGB to linear ACEScg (Finlayson2015), as `colour_chart.apply` takes it; None where
        its leave-one-out error is not clearly lower than the matrix's.
    curve
        Linear light of the 256 codes of photographs whose response curve was recovered; else empty.
    chart : (24,)
        All patches, row by row from dark skin; empty for photographs without a chart.
    lamp
        Lamp that the chart's reference colours are for; empty for the published ones.
    generation
        Generation of the chart whose published colours its patches come nearest to; empty without a chart.
    lamps : (light,)
        Light of each lamp of a set over the picture, relative to the mean of the lamps in the middle; empty where no
        card was photographed.
    """

    fabric: str
    plan_sha256: str
    height: int
    width: int
    encoding: str
    crop: str
    camera: CalibratedCamera | None
    colour: str
    to_acescg: tuple[tuple[float, float, float], ...]
    delta_e: tuple[float, ...]
    patches: tuple[int, ...] = ()
    root_polynomial: tuple[tuple[float, ...], ...] | None = None
    curve: tuple[float, ...] = ()
    chart: tuple[Patch, ...] = ()
    lamp: str = ""
    generation: str = ""
    lamps: tuple[Flat, ...] = ()

    @property
    def matrix(self) -> NDArray[np.float64]:
        """`to_acescg` as an array (3, 3)."""
        return np.array(self.to_acescg, float)

    def noise(self) -> dict[str, Any]:
        """Return the noise model in the form of the stack's attributes."""
        if self.camera is None:
            return {"kind": "photograph"}
        camera = self.camera
        return {
            "kind": "raw",
            "counts_per_electron": camera.response.gain,
            "read_counts": camera.response.read,
            "relative_coding": camera.response.coding,
            "saturation_counts": camera.response.saturation,
            "relative_prnu": camera.prnu,
            "planes": len(camera.black),
            "seconds": [exposure.seconds for exposure in camera.exposures],
            "white": "longest exposure" if self.encoding else "diffuser",
            "white_counts_per_second": list(camera.white),
        }


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration, atomically."""
    write_json(path, {"version": VERSION, **asdict(calibration)})


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.

    Raises
    ------
    InputError
        The file is missing, of another version, or not a calibration.
    """
    value = read_json(path)
    try:
        if value.pop("version") != VERSION:
            raise InputError(f"{path}: is of another version; calibrate again")
        camera = value.pop("camera")
        if camera is not None:
            camera["response"] = Response(**camera["response"])
            camera["exposures"] = tuple(
                Exposure(**{**exposure, "curtain": tuple(exposure["curtain"])}) for exposure in camera["exposures"]
            )
            camera["bad"] = tuple((int(k), int(y), int(x)) for k, y, x in camera["bad"])
            camera["flats"] = _flats(camera["flats"])
            camera = CalibratedCamera(**{**camera, "black": tuple(camera["black"]), "white": tuple(camera["white"])})
        matrix = tuple((float(a), float(b), float(c)) for a, b, c in value.pop("to_acescg"))
        root = value.pop("root_polynomial")
        value["root_polynomial"] = root and tuple(tuple(float(term) for term in row) for row in root)
        value |= {name: tuple(value[name]) for name in ("delta_e", "patches", "curve")}
        value["chart"] = tuple(_patch(patch) for patch in value.get("chart", ()))
        value["lamps"] = _flats(value.get("lamps", ()))
        return Calibration(**{**value, "camera": camera, "to_acescg": matrix})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is not a calibration ({error}); calibrate again") from None


def _flats(values: Iterable[dict[str, Any]]) -> tuple[Flat, ...]:
    return tuple(Flat(v["theta"], v["phi"], tuple(tuple(part) for part in v["coefficients"])) for v in values)


def _patch(value: dict[str, Any]) -> Patch:
    (a, b, c), (x, y, z) = value.pop("colour"), value.pop("reference")
    return Patch((a, b, c), (x, y, z), **value)
