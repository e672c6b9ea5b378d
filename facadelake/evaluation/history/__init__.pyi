from .comparison import CalledState as CalledState
from .comparison import HistoryComparison as HistoryComparison
from .comparison import MeasuredDefect as MeasuredDefect
from .comparison import compare_histories as compare_histories
from .figures import HistoryFigures as HistoryFigures
from .figures import compute_history_figures as compute_history_figures
from .truth import TrueDefect as TrueDefect
from .truth import read_history_truth as read_history_truth
