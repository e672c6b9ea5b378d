from .tiled_detection import detect_image as detect_image
