from .committed import compare_campaign as compare_campaign
from .evaluate import figures_of as figures_of
from .figures import Figures as Figures
from .paper_table2 import PAPER_REMARK as PAPER_REMARK
from .plots import write_plots as write_plots
