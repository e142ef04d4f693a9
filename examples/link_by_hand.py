"""The link by hand: one drive for a second, without table and touch; then the board falls silent by itself.

tactable emulate --device reference-a     (in another terminal; SIMULATED, prints the port)
python examples/link_by_hand.py PORT
"""

import sys
import time

from tactable import ChannelDrive, Link, LinkConfiguration, LinkState, SerialPort, Session, encode_drive

TENTH = (0.1, 0.1)  # of full scale: the board clamps to this by itself, whatever comes

with SerialPort(sys.argv[1]) as port:
    session = Session(Link(LinkConfiguration(2, amplitude_limits=TENTH)), port, time.monotonic_ns)
    session.connect()
    while session.link.state is not LinkState.READY:  # greeting, clocks compared, armed
        session.exchange()
        time.sleep(0.001)
    board = session.link.capabilities
    assert board is not None
    print(f"ready: {board.number_of_actuators} actuators, SIMULATED where `emulate` is the board")
    drive = [ChannelDrive(150, 0.1), ChannelDrive(130, 0.1)]  # Hz and a fraction of full scale
    session.link.set_drive(encode_drive(drive, board.frequency_resolution_hz))
    end_s = time.monotonic() + 1
    while time.monotonic() < end_s:  # each exchange renews the lease; without it the board is silent after 40 ms
        session.exchange()
        time.sleep(0.001)
    print("played for a second")
