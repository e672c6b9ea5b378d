"""Numbers of the ids of chains, from what the lake knows of the building's tracks."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import RowIndices
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import list_rows
from facadelake.tracking.campaign_defects import CLASSES
from facadelake.tracking.identity import Chains, KnownTracks, assign_track_numbers, read_track_number
from facadelake.tracking.linked import LinkedHistory
from schemas.vocabulary import DefectClass

_REACH_MIN_M = 0.3  # from a track's place, within which the same defect lies when its campaign is inspected anew
_GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")


def assign_chain_numbers(history: LinkedHistory, tracks: pa.Table, states: pa.Table, origin: SiteOrigin) -> RowIndices:
    """Numbers of the chains' ids.

    Args:
        history: the campaigns, linked.
        tracks: rows of the building's known tracks.
        states: of their states.
        origin: origin of the site frame.
    """
    rows = list_rows(tracks)
    of_track = {row["track_id"]: k for k, row in enumerate(rows)}
    sightings = {
        (row["campaign_id"], row["run_id"], row["defect_id"]): of_track[row["track_id"]]
        for row in list_rows(states.select(["campaign_id", "run_id", "defect_id", "track_id"]))
        if row["defect_id"] is not None and row["track_id"] in of_track
    }
    geo = np.array([[row[name] for name in _GEO] for row in rows]).reshape(-1, 3)
    known = KnownTracks(
        number=np.array([read_track_number(row["track_id"]) for row in rows], dtype=np.int64),
        xyz_site_m=origin.site_from_geo(geo) if len(rows) else geo,
        reach_m=np.array([max(_REACH_MIN_M, np.hypot(row["width_m"], row["height_m"]) / 2) for row in rows]),
        defect_class=np.array([CLASSES.index(DefectClass(row["defect_class"])) for row in rows], dtype=np.int64),
        sightings=sightings,
    )
    places, classes, lists = [], [], []
    links = [history.find_link(k) for k in range(len(history.campaigns))]
    for one in history.sightings:
        last = max(one)
        defects = history.campaigns[last].tracked.defects
        places.append(defects.xyz_site_m[one[last].row] - links[last].offset_m[one[last].row])
        classes.append(int(defects.defect_class[one[last].row]))
        lists.append(
            [
                (
                    history.campaigns[k].campaign_id,
                    history.campaigns[k].run_id,
                    str(history.campaigns[k].tracked.defects.defect_id[sighting.row]),
                )
                for k, sighting in one.items()
            ]
        )
    chains = Chains(
        xyz_site_m=np.array(places).reshape(-1, 3), defect_class=np.array(classes, dtype=np.int64), sightings=lists
    )
    return assign_track_numbers(known, chains)
