from .coverage_styles import COLOUR_MAP as COLOUR_MAP
from .coverage_styles import NOT_IMAGED_FILLS as NOT_IMAGED_FILLS
from .coverage_styles import NOT_SEARCHED_FILL as NOT_SEARCHED_FILL
from .coverage_styles import choose_limits_mm as choose_limits_mm
from .export import export_table as export_table
from .releases import publish_campaign as publish_campaign
from .releases import publish_regraded as publish_regraded
