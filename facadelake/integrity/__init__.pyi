from .views import integrity_views as integrity_views
from .views import nothing_to_compare as nothing_to_compare
