"""Experiments: recordings in and out, as named, timed columns with units."""

from artibot_sim.experiment.can_frames import CanFrame, can_topics, iter_frames
from artibot_sim.experiment.columns import Channel, Experiment
from artibot_sim.experiment.messages import serialize
from artibot_sim.experiment.naming import open_recording
from artibot_sim.experiment.reader import bag_info, read_bag
from artibot_sim.experiment.recover import RecoverReport, recover
from artibot_sim.experiment.rollout_bag import write_channels, write_experiment
from artibot_sim.experiment.storage import BagInfo, ChannelInfo, RawMessage, iter_messages
from artibot_sim.experiment.topics import Qos, parse_renames
from artibot_sim.experiment.writer import BagWriter

__all__ = [
    "BagInfo",
    "BagWriter",
    "CanFrame",
    "Channel",
    "ChannelInfo",
    "Experiment",
    "Qos",
    "RawMessage",
    "RecoverReport",
    "bag_info",
    "can_topics",
    "iter_frames",
    "iter_messages",
    "metrics",
    "open_recording",
    "parse_renames",
    "read_bag",
    "recover",
    "serialize",
    "write_channels",
    "write_experiment",
]
