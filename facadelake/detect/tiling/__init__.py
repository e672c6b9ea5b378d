"""Photographs of any size before a detector: which tiles it looks at, at which scale, what the pieces make together."""

from facadelake.detect.tiling.look import detect_image

__all__ = ["detect_image"]
