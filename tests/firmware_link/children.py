"""Child processes for the tests of `base.child`: each does what its arguments say."""

import os
import sys
import time
from typing import Any

from base.child import Child, Parent
from base.errors import TactableError


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    match arguments["do"]:
        case "echo":
            sys.stdout.write("this is no line of the protocol\n")
            parent.say({"ready": os.getpid(), "input": sys.stdin.read()})
            while (line := parent.read()) is not None:
                parent.say({"heard": line})
            parent.say({"last": "words"})
        case "fail":
            raise TactableError("no such bar: plug one in")
        case "write":
            order = parent.read() or {}
            os.write(parent.descriptors.pop(), order["text"].encode())
        case "ignore":
            parent.say({"ready": os.getpid()})
            time.sleep(600)
        case "compute":
            parent.end_with_it()
            parent.say({"ready": os.getpid()})
            time.sleep(600)
        case "start":  # a child of its own, whose process it tells
            with Child("tests.firmware_link.children", {"do": arguments["what"]}) as child:
                parent.say(child.read(60))
                parent.read()
