"""The line of a simulated Grbl board: real-time bytes picked out of the stream, the rest in lines of limited length."""

from abc import abstractmethod

from anisoscope.sim.bench.firmware.device import SimulatedDevice

STATUS, CYCLE_START, FEED_HOLD, RESET, DOOR, JOG_CANCEL = b"?", b"~", b"!", b"\x18", b"\x84", b"\x85"
_REAL_TIME = frozenset(byte[0] for byte in (STATUS, CYCLE_START, FEED_HOLD, RESET))
RX_BUFFER = 127
LINE_LENGTH = 79
OVERFLOW = 11


class GrblLine(SimulatedDevice):
    """A board as far as its line goes; what it does with bytes and lines is added by `_real_time` and `_obey`."""

    _rx: bytearray

    @abstractmethod
    def _real_time(self, byte: bytes) -> None:
        """Act on a real-time byte, at once."""

    @abstractmethod
    def _obey(self, line: str) -> None:
        """Carry out a line without blanks and comments, in capitals, and answer it."""

    @abstractmethod
    def _waiting(self) -> bool:
        """Whether lines have to wait: for the end of a search, a pause, or room in the queue of moves."""

    @property
    def rx_free(self) -> int:
        """Bytes that the receive buffer still takes."""
        return RX_BUFFER - len(self._rx)

    def _take_packet(self) -> bool:
        """Pass one byte on: real-time bytes overtake the lines that wait in the receive buffer."""
        if not self._inbox or self._dead:
            self._inbox.clear()
            return False
        byte = bytes(self._inbox[:1])
        del self._inbox[:1]
        if byte[0] in _REAL_TIME or byte[0] >= 0x80:
            self._attend()
            self.commands.append(byte)
            self._real_time(byte)
        elif self.rx_free > 0:
            self._rx += byte
            if byte in b"\r\n":
                self._take_lines()
        return True

    def _take_lines(self) -> None:
        while not (self._dead or self._waiting()):
            ends = [place for place in (self._rx.find(b"\n"), self._rx.find(b"\r")) if place >= 0]
            if not ends:
                return
            raw = bytes(self._rx[: min(ends)])
            del self._rx[: min(ends) + 1]
            line = clean(raw.decode("latin-1"))
            if line:
                self.commands.append(line.encode("latin-1"))
            if len(line) > LINE_LENGTH:
                self._answer(OVERFLOW)
            else:
                self._obey(line)

    def _answer(self, error: int) -> None:
        """Say how a line ended: 0 is ok."""
        self._say(b"error:%d\r\n" % error if error else b"ok\r\n")


def clean(line: str) -> str:
    """Drop blanks, control characters, slashes and comments, as Grbl does; letters become capitals."""
    kept = []
    in_brackets = False
    for character in line:
        if in_brackets or character == "(":
            in_brackets = character != ")"
        elif character == ";":
            break
        elif character > " " and character != "/":
            kept.append(character.upper())
    return "".join(kept)
