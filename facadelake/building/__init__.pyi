from .model import SURFACE_FILE as SURFACE_FILE
from .model import BuildingModel as BuildingModel
from .model import mask_target_elements as mask_target_elements
from .model import read_building as read_building
from .registry_settings import check_registered_mesh as check_registered_mesh
from .registry_settings import mesh_settings_from_registry as mesh_settings_from_registry
from .registry_settings import read_registered_model as read_registered_model
from .storeys import find_storeys as find_storeys
