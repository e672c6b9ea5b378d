from .reference import REFERENCE as REFERENCE
from .reference import drop_reference as drop_reference
from .reference import earlier_references as earlier_references
from .reference import keep_reference as keep_reference
from .reference import read_reference as read_reference
