from .directions import collect_facades as collect_facades
from .openness import COMPASS as COMPASS
