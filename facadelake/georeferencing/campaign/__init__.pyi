from .reference import REFERENCE_FILE as REFERENCE_FILE
from .reference import drop_reference as drop_reference
from .reference import list_references as list_references
from .reference import read_reference as read_reference
from .reference import store_reference as store_reference
