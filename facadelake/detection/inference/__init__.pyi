from .card_lookup import find_card as find_card
from .detector import DetectedBox as DetectedBox
from .detector import OnnxDetector as OnnxDetector
from .detector import hash_detector as hash_detector
from .detector import load_detector as load_detector
from .photograph import read_exif_orientation as read_exif_orientation
from .photograph import read_photograph as read_photograph
