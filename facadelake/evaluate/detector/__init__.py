"""A detector against labelled photographs: average precision, false alarms, calibration, sites. It never tunes one."""
