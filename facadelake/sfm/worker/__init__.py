"""The process in which pycolmap runs: ``python -m facadelake.sfm.worker JOB.json``.

Reason: in one process with OpenCV or Pillow, two versions of zlib collide and writing a PNG aborts ("double free"). The
process also contains native crashes and frees its memory at its end. Therefore no module here compresses anything or
imports OpenCV, Pillow or Open3D, and no module outside imports pycolmap.
"""
