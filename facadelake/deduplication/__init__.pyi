from .appearance import Photographs as Photographs
from .merge import MergeResult as MergeResult
from .merge import merge_observations as merge_observations
from .settings import merge_settings as merge_settings
