"""What tracking reads of each campaign, moved into one site frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import pyarrow as pa

from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SITE_AXES, SiteOrigin
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import list_rows
from facadelake.tracking.campaign_defects import DefectArrays, TrackedCampaign, read_defects
from facadelake.tracking.size_change import DefectSizes
from facadelake.tracking.sizes import read_sizes
from schemas.vocabulary import TrendQuantity

ORIGIN_COLUMNS = ("origin_lon_deg", "origin_lat_deg", "origin_height_ellipsoidal_m")


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignRecords:
    """A committed campaign: its defects and poses in the site frame of ``origin`` of ``read_records``.

    ``inputs_sha256``: of its run, which identifies poses and photographs. ``time_remark``: what is to be said of
    ``captured_at``. ``defect_table``: rows of table ``defects``, in the order of ``tracked.defects``.
    """

    run_id: str
    inputs_sha256: str
    tracked: TrackedCampaign
    defect_table: pa.Table
    sizes: Mapping[TrendQuantity, DefectSizes]
    posed: Mapping[str, PosedCamera]
    root: Path
    time_remark: str | None = None

    @property
    def campaign_id(self) -> str:
        """The campaign."""
        return self.tracked.campaign_id


def read_records(tables: Mapping[str, pa.Table], *, captured_at: datetime, origin: SiteOrigin) -> CampaignRecords:
    """The records of one campaign.

    Args:
        tables: one campaign's rows of tables buildings, campaigns, runs, georeference, poses, observations, defects.
        captured_at: when the campaign was flown.
        origin: origin of the site frame of all campaigns of the building.
    """
    building, passport, run = (list_rows(tables[name])[0] for name in ("buildings", "georeference", "runs"))
    own = SiteOrigin(**{name.removeprefix("origin_"): building[name] for name in ORIGIN_COLUMNS})
    site_from_own = origin.ecef_from_site().invert() @ own.ecef_from_site()
    defects = tables["defects"]
    return CampaignRecords(
        run_id=run["run_id"],
        inputs_sha256=run["inputs_sha256"],
        tracked=TrackedCampaign(
            campaign_id=run["campaign_id"],
            captured_at=captured_at,
            frame_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in SITE_AXES),
            defects=_move(read_defects(defects), site_from_own),
        ),
        defect_table=defects,
        sizes=read_sizes(defects, tables["observations"]),
        posed={
            photo_id: replace(posed, site_from_cam=site_from_own @ posed.site_from_cam)
            for photo_id, posed in read_posed_cameras(tables["poses"]).items()
        },
        root=Path(tables["campaigns"].column("photographs_uri").to_pylist()[0]),
    )


def _move(defects: DefectArrays, target_from_source: Similarity) -> DefectArrays:
    """The defects in another site frame."""
    rotation = target_from_source.rotation
    return replace(
        defects,
        xyz_site_m=target_from_source.apply(defects.xyz_site_m),
        covariance_m2=rotation @ defects.covariance_m2 @ rotation.T,
        normal_site=target_from_source.rotate(defects.normal_site),
    )
