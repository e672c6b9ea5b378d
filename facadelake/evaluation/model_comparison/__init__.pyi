from .box_changes import Change as Change
from .compare import DetectorComparisonResult as DetectorComparisonResult
from .compare import compare_models as compare_models
from .promote import promote_model as promote_model
from .report import REPORT as REPORT
from .report import CampaignComparison as CampaignComparison
