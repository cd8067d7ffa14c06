"""Live clouds from a short sequence, decoded during the capture; kept clouds become stations."""

from scanner.live.cloud import Decoder, LiveCloud, Round
from scanner.live.jobs import LiveResult, Watcher, Wishes, scan_live
from scanner.live.sequence import LiveSequence
from scanner.live.texts import account_text, result_texts, round_texts
from scanner.live.watching import Account, Newest, watch
