"""The history of a building as published: its tracks, and their states in all campaigns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.publish.columns import PATCH
from facadelake.publish.geopackage import GisLayer, create_facade_layers, create_map_layers
from facadelake.publish.state_styles import create_state_style

# Of all campaigns of the building.
TABLES = ("tracks", "track_states", "campaigns", "defects")
_OF_TRACK = (
    "facade", "facade_azimuth_deg", "storey", "element_guid", "ifc_class", "element_name", "material",
    "first_campaign", "first_seen_at", "last_campaign", "last_seen_at", "withdrawn",
)  # fmt: skip
_OF_DEFECT = (
    "severity", "severity_rule", "width_m", "height_m", "length_m", "area_m2", "crack_width_mm",
    "crack_width_sigma_mm", "photo_count", "score", "best_photo_id", "best_photo_uri",
)  # fmt: skip
_OF_CAMPAIGN = ("captured_from", "captured_to")


def join_states(tables: Mapping[str, pa.Table]) -> pa.Table:
    """Table ``track_states`` with the place of its tracks, and with the sizes and times of its campaigns.

    A column has its meaning in ``docs/tables.md``: sizes and severity are those of the campaign, and null where it did
    not detect the defect. Rows are in order of track and capture time.
    """
    joined = tables["track_states"]
    for name, keys, columns in (
        ("tracks", ["building_id", "track_id"], _OF_TRACK),
        ("defects", ["building_id", "campaign_id", "defect_id"], _OF_DEFECT),
        ("campaigns", ["building_id", "campaign_id"], _OF_CAMPAIGN),
    ):
        joined = joined.join(tables[name].select([*keys, *columns]), keys=keys, join_type="left outer")
    return joined.sort_by([(name, "ascending") for name in ("track_id", "captured_from", "campaign_id")])


def create_history_layers(tracks: pa.Table, states: pa.Table) -> Iterator[GisLayer]:
    """Layers of tracks and of the rows of ``join_states``, styled by state; none where there are no tracks.

    ``tracks`` and ``track_states``, each also in 3D, and in each facade's plane the outlines of its tracks. A
    withdrawn track has no state and is in no layer.
    """
    current = tracks.filter(pc.invert(tracks.column("withdrawn")))
    if not len(current):
        return
    points = current.drop_columns([PATCH])
    for layers in (
        create_map_layers(points, "tracks"),
        create_map_layers(states, "track_states"),
        create_facade_layers(current, "tracks"),
    ):
        for layer in layers:
            yield replace(layer, style=create_state_style(layer.geometry_type))
