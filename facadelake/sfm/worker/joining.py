"""Several blocks of one campaign made one, where they share photographs."""

from __future__ import annotations

from pathlib import Path

import pycolmap

from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import add_posed_image

_MIN_SHARED_PHOTOS = 3
# Of the points of one block seen in a shared photograph, the share that must fall where the other block has them.
_MIN_INLIER_SHARE = 0.3
_MAX_ERROR_PX = 8.0


def join_blocks(
    models: list[pycolmap.Reconstruction], database_path: Path, report: ProgressReport
) -> tuple[pycolmap.Reconstruction, list[pycolmap.Reconstruction]]:
    """The largest block with those added that share three photographs with it, and the blocks that stay apart.

    A smaller block is moved onto the larger one by the shared photographs (a robust similarity, checked by reprojecting
    points); its other photographs come with their poses, and their points are triangulated anew in the joint block.
    """
    block, others = models[0], models[1:]
    block.tear_down()
    apart: list[pycolmap.Reconstruction] = []
    with report.step("Joining blocks", len(others)):
        for other in others:
            fitted = None
            if len(block.find_common_reg_image_ids(other)) >= _MIN_SHARED_PHOTOS:
                fitted = pycolmap.align_reconstructions_via_reprojections(
                    other, block, min_inlier_observations=_MIN_INLIER_SHARE, max_reproj_error=_MAX_ERROR_PX
                )
            if fitted is None:
                apart.append(other)
            else:
                other.transform(fitted)
                _merge_block(block, other, database_path)
            report.advance()
    return block, apart


def _merge_block(block: pycolmap.Reconstruction, other: pycolmap.Reconstruction, database_path: Path) -> None:
    with pycolmap.Database.open(database_path) as database:
        new = sorted(set(other.reg_image_ids()) - set(block.reg_image_ids()))
        for image_id in new:
            image = other.images[image_id]
            add_posed_image(block, database, image_id, other.cameras[image.camera_id], image.cam_from_world())
        wanted = pycolmap.DatabaseCacheOptions()
        wanted.min_num_matches = pycolmap.IncrementalPipelineOptions().min_num_matches
        cache = pycolmap.DatabaseCache.create(database, wanted)
    triangulator = pycolmap.IncrementalTriangulator(
        cache.correspondence_graph, block, pycolmap.ObservationManager(block, cache.correspondence_graph)
    )
    options = pycolmap.IncrementalTriangulatorOptions()
    for image_id in new:
        triangulator.triangulate_image(options, image_id)
    triangulator.complete_all_tracks(options)
    triangulator.merge_all_tracks(options)
