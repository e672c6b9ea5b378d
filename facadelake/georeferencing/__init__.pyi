from .available_control import Control as Control
from .georeference import georeference_reconstruction as georeference_reconstruction
from .placement_checks import build_checks_table as build_checks_table
from .poses_table import build_poses_table as build_poses_table
from .site_frame import SiteFrame as SiteFrame
