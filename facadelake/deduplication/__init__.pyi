from .appearance import PhotographSource as PhotographSource
from .merge import MergeResult as MergeResult
from .merge import merge_observations as merge_observations
from .settings import resolve_merge_settings as resolve_merge_settings
