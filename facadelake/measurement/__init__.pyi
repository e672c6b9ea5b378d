from .blur import TYPICAL_BLUR as TYPICAL_BLUR
from .blur_map import BlurMap as BlurMap
from .blur_map import map_blur as map_blur
from .campaign import measure_detections as measure_detections
