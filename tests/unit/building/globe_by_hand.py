"""Places by an independent path: the map conversion and ECEF written out, and pyproj's own pipeline."""

import numpy as np
import pyproj

CONVERSION = {
    "Eastings": 456639.25,
    "Northings": 5421033.5,
    "OrthogonalHeight": 178.25,
    "XAxisAbscissa": float(np.cos(np.radians(30))),
    "XAxisOrdinate": float(np.sin(np.radians(30))),
}
CRS = {"Name": "EPSG:25832", "Description": "heights are ellipsoidal"}


def expected_geo(corners_m, factor=1.0):
    """Corners in the model's metres as lon, lat, height: the conversion by hand, then pyproj's own pipeline."""
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    x, y, z = np.asarray(corners_m).T
    east = 456639.25 + factor * (c * x - s * y)
    north = 5421033.5 + factor * (s * x + c * y)
    pipeline = pyproj.Transformer.from_pipeline("+proj=pipeline +step +inv +proj=utm +zone=32 +ellps=GRS80")
    lon, lat = pipeline.transform(east, north)
    return np.column_stack([lon, lat, 178.25 + z])


def ecef(geo):
    """ECEF written out (the direct formula has no iteration to get wrong)."""
    lon, lat, h = np.radians(geo[:, 0]), np.radians(geo[:, 1]), geo[:, 2]
    a, f = 6378137.0, 1 / 298.257222101
    e2 = f * (2 - f)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.column_stack(
        [(n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon), (n * (1 - e2) + h) * np.sin(lat)]
    )


def corners_of(box):
    grid = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    return grid * box.size_m + box.corner_m


def assert_same_places(building, geo):
    """Every expected place is a vertex of the building, compared in ECEF metres."""
    found = ecef(building.origin.geo_from_site(building.vertices_site_m))
    for place in ecef(geo):
        assert np.linalg.norm(found - place, axis=1).min() < 0.0005  # m


def geo_of_east_north_up(lon_deg, lat_deg, height_m, east_north_up_m):
    """Places (n, 3) of EPSG:4979 that lie so many metres east, north and up of one, by ECEF and pyproj's inverse."""
    lon, lat = np.radians([lon_deg, lat_deg])
    axes = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    xyz = ecef(np.array([[lon_deg, lat_deg, height_m]])) + np.asarray(east_north_up_m) @ axes
    geocentric = pyproj.Transformer.from_pipeline("+proj=pipeline +step +inv +proj=cart +ellps=GRS80")
    return np.column_stack(geocentric.transform(xyz[:, 0], xyz[:, 1], xyz[:, 2]))
