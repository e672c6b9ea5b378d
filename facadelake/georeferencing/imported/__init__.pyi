from .placement import place_imported_poses as place_imported_poses
from .pose_files import list_pose_files as list_pose_files
from .pose_files import read_poses as read_poses
