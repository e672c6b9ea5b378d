from .cards import find_card as find_card
from .detector import Found as Found
from .detector import OnnxDetector as OnnxDetector
from .detector import detector_fingerprint as detector_fingerprint
from .detector import load_detector as load_detector
from .photograph import read_photograph as read_photograph
from .photograph import turned_by_exif as turned_by_exif
