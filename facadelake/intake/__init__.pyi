from .campaigns_in_place import CampaignObservation as CampaignObservation
from .campaigns_in_place import observe_campaign as observe_campaign
from .observation_time import ObservationTime as ObservationTime
from .observation_time import read_clock as read_clock
