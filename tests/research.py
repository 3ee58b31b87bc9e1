"""Puts scripts/research where its modules are found by their plain names, here and in processes started from here."""

from __future__ import annotations

import sys
from pathlib import Path

RESEARCH = Path(__file__).parents[1] / "scripts" / "research"

if str(RESEARCH) not in sys.path:
    sys.path.insert(0, str(RESEARCH))
