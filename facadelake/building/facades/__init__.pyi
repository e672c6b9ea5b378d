from .directions import Facades as Facades
from .directions import azimuth_from_direction as azimuth_from_direction
from .directions import collect_facades as collect_facades
from .directions import measure_turn_deg as measure_turn_deg
from .wall_directions import ModelTriangles as ModelTriangles
from .wall_directions import collect_triangles as collect_triangles
from .wall_directions import find_facade_triangles as find_facade_triangles
