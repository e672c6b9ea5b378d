"""PROJ: CRSs and their areas of use, coordinate operations chosen for a place, installed grids."""
