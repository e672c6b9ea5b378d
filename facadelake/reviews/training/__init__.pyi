from .collect import make_training_set as make_training_set
from .options import PictureMode as PictureMode
from .options import Split as Split
from .options import TrainingLabelFormat as TrainingLabelFormat
from .training_set import MANIFEST as MANIFEST
from .training_set import TrainingSet as TrainingSet
