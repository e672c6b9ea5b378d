from .model import SURFACE_FILE as SURFACE_FILE
from .model import BuildingModel as BuildingModel
from .model import read_building as read_building
from .registered import bare_settings as bare_settings
from .registered import read_registered_model as read_registered_model
from .storeys import storeys_of_places as storeys_of_places
from .targets import target_elements as target_elements
