from .collect import make_training_set as make_training_set
from .forms import LabelForm as LabelForm
from .forms import Pictures as Pictures
from .splits import Split as Split
from .training_set import MANIFEST as MANIFEST
from .training_set import TrainingSet as TrainingSet
