"""``python -m fake_sweep`` is ``sweep`` with a made-up evaluator: everything around the physics, in no time.

FAKE_MODES, FAKE_SECONDS, FAKE_HOLD: see ``fakes.planned``. FAKE_EVALUATOR: another of ``fakes``. FAKE_SKEW: seconds by
which the clock of each further rank is behind the one before. FAKE_SILENCE: how long rank 0 waits for a rank that says
nothing; ranks say something ten times as often. FAKE_GRACE: how long points in flight have after SIGUSR1.
"""

from __future__ import annotations

import os
import time

import fakes

from sweep import cli, distribute, run


def main() -> None:
    evaluator = f"{fakes.HERE}:{os.environ.get('FAKE_EVALUATOR', 'planned')}"
    run.Settings.__init__.__kwdefaults__ |= {"evaluator": evaluator, "warm_ups": ()}
    silence = float(os.environ.get("FAKE_SILENCE", distribute.SILENCE))
    distribute.Job.__init__.__kwdefaults__["silence"] = silence
    distribute.ALIVE = min(distribute.ALIVE, silence / 10)
    distribute.GRACE["SIGUSR1"] = float(os.environ.get("FAKE_GRACE", distribute.GRACE["SIGUSR1"]))
    if skew := float(os.environ.get("FAKE_SKEW", "0")):
        behind = skew * distribute.world().rank
        clock = time.time
        time.time = lambda: clock() - behind
    cli.main()


if __name__ == "__main__":
    main()
