from .bootstrap import BootstrapInterval as BootstrapInterval
from .card_results import write_results as write_results
from .contact_sheet import write_sheets as write_sheets
from .evaluate import (
    DetectorEvaluation as DetectorEvaluation,
)
from .evaluate import (
    DetectorEvaluationRequest as DetectorEvaluationRequest,
)
from .evaluate import (
    evaluate_prediction_source as evaluate_prediction_source,
)
from .evaluate import (
    locate_model_file as locate_model_file,
)
from .evaluate import (
    open_prediction_source as open_prediction_source,
)
from .figures import DetectorFigures as DetectorFigures
from .image_level import ImageLevelFigures as ImageLevelFigures
from .operating_point import OperatingPoint as OperatingPoint
from .page import render_model_page as render_model_page
from .plots import write_plots as write_plots
