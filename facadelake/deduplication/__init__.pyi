from .appearance import PhotographSource as PhotographSource
from .crack_width import describe_width_blur as describe_width_blur
from .merge import MergeResult as MergeResult
from .merge import merge_observations as merge_observations
from .settings import resolve_merge_settings as resolve_merge_settings
