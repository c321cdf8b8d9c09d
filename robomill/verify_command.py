"""`robomill verify`: is a release archive what the holder of a key signed?"""

from __future__ import annotations

import json
import sys
from argparse import Namespace

from robomill.fmus.signed import SignatureError, verify


def run(options: Namespace) -> int:
    """Say what the archive holds; status 1 if it is not what was signed."""
    try:
        names = verify(options.archive, options.key)
    except SignatureError as error:
        if options.json:
            print(json.dumps({"archive": str(options.archive), "valid": False, "error": str(error)}))
        print(f"robomill verify: {error}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps({"archive": str(options.archive), "valid": True, "files": names}))
    else:
        print(f"{options.archive}: {len(names)} files, all as signed: {', '.join(names)}")
    return 0
