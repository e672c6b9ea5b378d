from .inspection import Inspection as Inspection
from .inspection import PictureSettings as PictureSettings
from .photo_view import view_photograph as view_photograph
from .pictures import DrawnPictures as DrawnPictures
from .pictures import draw_pictures as draw_pictures
