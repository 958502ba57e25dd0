"""What is known of the camera, the lamp and the colours of a capture: `calibration.json`."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, read_json, write_json
from kinran.data.flat_field import Flat

VERSION = 2
"""Of the file's layout."""
MARGIN = 0.99
"""Counts over this share of the measured saturation are saturated. Too low biases nothing, and 0.95 costs 6 % of RMSE;
too high biases: by 4.8 % where 10 % too high (on the synthetic camera of ``kinran bench merge``)."""


@dataclass(frozen=True)
class Response:
    """What a sensor makes of electrons.

    Attributes
    ----------
    saturation
        Counts over black at which a site is full.
    gain
        Counts per electron.
    read
        Standard deviation of darkness in counts, rounding included.
    coding
        Standard deviation of what encoding adds to a photograph, relative to the signal: the steps of its codes, which
        grow with the light, and the losses of JPEG. 0 for RAW.
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
    """A shutter time.

    Attributes
    ----------
    nominal_s
        Time on the dial in seconds.
    prior_s
        The third stop that it means.
    seconds
        Measured time, relative to the longest, which is at its third stop.
    sites
        Sensor sites that measured it; 0 where none could, and `seconds` follows `prior_s`.
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
        Counts of darkness of R, G1, G2, B: relative to the mean under the mask if `masked`. (3,) for photographs.
    masked
        Whether frames have a mask under which darkness is measured each time.
    response
        Saturation, gain and read noise.
    exposures
        Longest first.
    bad : (plane, y, x)
        Hot and dead sites.
    white : (3,)
        Counts per second of R, G, B of the white plate at θ = 0: π·T = 1.
    photodiode
        Its reading while the white plate was shot; None where the rig has none.
    monitor
        Counts per second that the fabric at θ = 0 gives (`level`) under the lamp that lit the white plate.
    flats
        Flat fields, one for each direction in which a white plate was shot.
    glare
        Share of a picture's mean light that is spread over it.
    prnu
        Relative standard deviation of the sites' responses.
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
        """Calibration of a nominal shutter time.

        Raises
        ------
        InputError
            It was not calibrated.
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
        Colour that was seen, free of glare, by the matrix: linear ACEScg under a white of 1.
    reference : (3,)
        Colour that it should have.
    delta_e
        ΔE00 of a matrix that has not seen the patch.
    root_delta_e
        The same of a root polynomial.
    left_out
        Why no fit uses it; empty where they do.
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
        None for photographs.
    colour
        Name of the stack's RGB.
    to_acescg : (3, 3)
        Stack RGB (column) to linear ACEScg.
    delta_e
        ΔE00 of the chart's patches, each left out of the fit in turn; empty for photographs.
    patches
        Which of the 24 patches these are; the others were saturated, hidden or contradicted by the rest.
    root_polynomial : (3, 6)
        Where the chart says that it is better than the matrix: stack RGB with its roots to linear ACEScg, as
        `colour_chart.apply` takes it. Else None.
    curve
        Linear light of the 256 codes of photographs whose response was recovered; else empty.
    chart : (24,)
        All patches, row by row from dark skin; empty for photographs.
    lamp
        Lamp that the chart's reference colours are for; empty for the published ones.
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

    @property
    def matrix(self) -> NDArray[np.float64]:
        """`to_acescg` as an array."""
        return np.array(self.to_acescg, float)

    def noise(self) -> dict[str, Any]:
        """The noise model for the stack's attributes."""
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
        The file is missing or no calibration.
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
            camera["flats"] = tuple(
                Flat(flat["theta"], flat["phi"], tuple(tuple(part) for part in flat["coefficients"]))
                for flat in camera["flats"]
            )
            camera = CalibratedCamera(**{**camera, "black": tuple(camera["black"]), "white": tuple(camera["white"])})
        matrix = tuple((float(a), float(b), float(c)) for a, b, c in value.pop("to_acescg"))
        root = value.pop("root_polynomial")
        value["root_polynomial"] = root and tuple(tuple(float(term) for term in row) for row in root)
        value |= {name: tuple(value[name]) for name in ("delta_e", "patches", "curve")}
        value["chart"] = tuple(_patch(patch) for patch in value.get("chart", ()))
        return Calibration(**{**value, "camera": camera, "to_acescg": matrix})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is not a calibration ({error}); calibrate again") from None


def _patch(value: dict[str, Any]) -> Patch:
    (a, b, c), (x, y, z) = value.pop("colour"), value.pop("reference")
    return Patch((a, b, c), (x, y, z), **value)
