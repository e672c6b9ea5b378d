from .evaluate import compare_campaign as compare_campaign
from .evaluate import compute_figures as compute_figures
from .figures import CampaignFigures as CampaignFigures
from .paper_table2 import PAPER_REMARK as PAPER_REMARK
from .plots import write_plots as write_plots
