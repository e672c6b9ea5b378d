"""What a stated height refers to, and the way from sea level to the ellipsoid where a geoid grid is at hand."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import numpy as np
from pyproj.transformer import TransformerGroup

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import GEO, transform
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from schemas.vocabulary import HeightDatum

RTK_FIXED = 50
EGM96 = "EPSG:4326+5773"


@dataclass(frozen=True, kw_only=True)
class HeightDatumEvidence:
    """What a height refers to, and how that is known."""

    datum: HeightDatum
    evidence: str


def infer_height_datum(drone: DroneMetadata | None, exif: ExifMetadata) -> HeightDatumEvidence:
    """Ellipsoidal or orthometric only with evidence.

    An RTK fix is ellipsoidal (differential positions are). DJI's AltitudeType says RtkAlt without a fix too, and
    GpsFusionAlt is barometric on some models: no evidence. Parrot's documentation names the datum by model (ANAFI Ai:
    ellipsoid; ANAFI 4K, Thermal, USA: EGM96). EXIF 2's reference 0 claims sea level, but Android, Skydio and others put
    ellipsoidal heights beside it: unknown. EXIF 3.0's references 2 and 3 are the ellipsoid's.
    """
    if drone is not None and drone.rtk_flag == RTK_FIXED:
        return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by the RTK fix")
    if drone is not None and drone.maker == "Parrot" and exif.model.upper().replace(" ", "").startswith("ANAFI"):
        if exif.model.upper().replace(" ", "").startswith("ANAFIAI"):
            return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by Parrot's documentation")
        return HeightDatumEvidence(datum=HeightDatum.ORTHOMETRIC, evidence="above EGM96 by Parrot's documentation")
    if exif.altitude_ref in (2, 3):
        return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by EXIF GPSAltitudeRef")
    return HeightDatumEvidence(datum=HeightDatum.UNKNOWN, evidence="of unknown datum")


def ellipsoidal_from_egm96(lon_deg: float, lat_deg: float, height_m: float) -> tuple[float, str] | None:
    """The ellipsoidal height and the grid it rests on; None where no EGM96 grid is on this machine."""
    try:
        geo = transform(np.array([[lon_deg, lat_deg, height_m]]), EGM96, GEO)
    except GeoreferenceError:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        best = TransformerGroup(EGM96, GEO, always_xy=True, allow_ballpark=False).transformers[0]
    grid = re.search(r"grids=(\S+)", best.definition)
    return float(geo[0, 2]), grid[1] if grid else best.description
