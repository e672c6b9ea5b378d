from .card_lookup import find_card as find_card
from .detector import DetectedBox as DetectedBox
from .detector import OnnxDetector as OnnxDetector
from .detector import hash_detector as hash_detector
from .detector import load_detector as load_detector
from .photograph import has_exif_rotation as has_exif_rotation
from .photograph import read_photograph as read_photograph
