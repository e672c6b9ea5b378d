from .generate import generate_demo as generate_demo
from .recipe import load_recipe as load_recipe
