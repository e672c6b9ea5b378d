from .rule_packs import BY_RULES as BY_RULES
from .rule_packs import GRADES as GRADES
from .rule_packs import grade as grade
from .rule_packs import rule_file as rule_file
