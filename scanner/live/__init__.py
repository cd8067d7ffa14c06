"""Live clouds from a short sequence, decoded during the capture; kept clouds become stations."""

from scanner.live.cloud import LiveCloud, LiveDecoder, Round
from scanner.live.first_look import FirstLook, look
from scanner.live.jobs import LiveResult, Watcher, Wishes, scan_live
from scanner.live.rounds import best_sequence, take_rounds
from scanner.live.sequence import FRAMES, LiveSequence
from scanner.live.watching import Account, Newest, account_text, proven, result_texts, round_texts, watch
