from .collect import make_training_set as make_training_set
from .forms import PictureMode as PictureMode
from .forms import TrainingLabelFormat as TrainingLabelFormat
from .splits import Split as Split
from .training_set import MANIFEST as MANIFEST
from .training_set import TrainingSet as TrainingSet
