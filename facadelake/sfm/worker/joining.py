"""Merging the blocks of a campaign that share photographs."""

from __future__ import annotations

from pathlib import Path

import pycolmap

from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import add_posed_image

_MIN_SHARED_PHOTOS = 3
# Minimum share of a shared photograph's points whose reprojection agrees with the other block.
_MIN_INLIER_SHARE = 0.3
_MAX_ERROR_PX = 8.0


def join_blocks(
    models: list[pycolmap.Reconstruction], database_path: Path, report: ProgressReport
) -> tuple[pycolmap.Reconstruction, list[pycolmap.Reconstruction]]:
    """The largest block, merged with those that share three photographs with it, and the blocks that remain separate.

    A smaller block is transformed into the larger one by the shared photographs (a robust similarity, verified by the
    reprojection of points). Its other photographs keep their poses; their points are triangulated in the joint block.
    """
    block, others = models[0], models[1:]
    block.tear_down()
    separate: list[pycolmap.Reconstruction] = []
    with report.step("Joining blocks", len(others)):
        for other in others:
            block_from_other = None
            if len(block.find_common_reg_image_ids(other)) >= _MIN_SHARED_PHOTOS:
                block_from_other = pycolmap.align_reconstructions_via_reprojections(
                    other, block, min_inlier_observations=_MIN_INLIER_SHARE, max_reproj_error=_MAX_ERROR_PX
                )
            if block_from_other is None:
                separate.append(other)
            else:
                other.transform(block_from_other)
                _merge_block(block, other, database_path)
            report.advance()
    return block, separate


def _merge_block(block: pycolmap.Reconstruction, other: pycolmap.Reconstruction, database_path: Path) -> None:
    """Add the photographs of ``other``, which is in the frame of ``block``, and triangulate their points."""
    with pycolmap.Database.open(database_path) as database:
        new = sorted(set(other.reg_image_ids()) - set(block.reg_image_ids()))
        for image_id in new:
            image = other.images[image_id]
            add_posed_image(block, database, image_id, other.cameras[image.camera_id], image.cam_from_world())
        cache_options = pycolmap.DatabaseCacheOptions()
        cache_options.min_num_matches = pycolmap.IncrementalPipelineOptions().min_num_matches
        cache = pycolmap.DatabaseCache.create(database, cache_options)
    triangulator = pycolmap.IncrementalTriangulator(
        cache.correspondence_graph, block, pycolmap.ObservationManager(block, cache.correspondence_graph)
    )
    options = pycolmap.IncrementalTriangulatorOptions()
    for image_id in new:
        triangulator.triangulate_image(options, image_id)
    triangulator.complete_all_tracks(options)
    triangulator.merge_all_tracks(options)
