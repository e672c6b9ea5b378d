from .load import place_without_model as place_without_model
from .load import with_surface as with_surface
