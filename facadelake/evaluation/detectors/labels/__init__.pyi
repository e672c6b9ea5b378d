from .format import Form as Form
