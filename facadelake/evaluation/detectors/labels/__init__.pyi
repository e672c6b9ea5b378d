from .format import LabelFormat as LabelFormat
