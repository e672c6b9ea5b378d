from .exif import FULL_FRAME_DIAGONAL_MM as FULL_FRAME_DIAGONAL_MM
from .files import find_masks as find_masks
from .files import find_photographs as find_photographs
from .ingest import ingest_photographs as ingest_photographs
from .positions_file.registered import list_position_remarks as list_position_remarks
from .positions_file.registered import read_registered_positions as read_registered_positions
from .read import find_first_capture_time as find_first_capture_time
from .utc_offset import describe_unknown_offsets as describe_unknown_offsets
