from .available_control import Control as Control
from .georeference import georeference_reconstruction as georeference_reconstruction
from .poses_table import build_poses_table as build_poses_table
from .site_frame import SiteFrame as SiteFrame
