from .export import export_table as export_table
from .releases import publish_campaign as publish_campaign
from .releases import publish_regraded as publish_regraded
