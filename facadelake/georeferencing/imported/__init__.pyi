from .placement import place_imported as place_imported
from .read import read_poses as read_poses
from .records import pose_files as pose_files
