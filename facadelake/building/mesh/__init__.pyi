from .load import attach_surface as attach_surface
from .load import place_building_without_model as place_building_without_model
