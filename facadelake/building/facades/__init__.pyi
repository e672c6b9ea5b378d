from .directions import facades_in as facades_in
from .openness import COMPASS as COMPASS
