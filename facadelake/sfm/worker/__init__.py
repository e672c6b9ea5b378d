"""The process of its own in which pycolmap works: ``python -m facadelake.sfm.worker JOB.json``.

Why apart: in one process with OpenCV or Pillow, pycolmap's zlib meets theirs and writing a PNG aborts ("double
free"); native crashes and memory stay here too. So nothing in this package deflates anything, and nothing outside
imports pycolmap.
"""
