from .views import compare_views as compare_views
from .views import record_uncompared_views as record_uncompared_views
