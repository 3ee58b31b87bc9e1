"""The long parts of the study: each is stored in its folder as soon as it is known, and read from there afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from ..casting import is_available
from ..study.landscape_stages import LandscapeStages, never
from ..study.landscapes import HELD_OUT, Job
from ..study.site import Site
from ..study.variation import Variation
from .attacked import attack_finding
from .attacks import ATTACKS
from .caster_attacks import JUDGED, AttackCount, count_attack
from .effort import Effort
from .findings import UNDECIDED, Finding
from .landscape import best_candidate, chooses
from .mountings import BASELINE, CANDIDATES, REFERENCE, Mountings
from .seeds import answer_of_seed, evaluations_of
from .variations import CASTERS
from .varied import Draw


class StoredStages(LandscapeStages):
    """The stages of this study."""

    def answers(self, site: Site, effort: Effort) -> list[dict]:
        """What the search finds with the scene's seed, and with the ones that follow it."""
        first = site.scenario.search.seed
        seeds = range(first, first + effort.seeds)
        names = {seed: f"seed_{seed}" for seed in seeds}
        missing = [seed for seed in seeds if not self._folder.holds(names[seed])]
        total = len(missing) * evaluations_of(site, effort.budget)
        if missing:
            with self.counting(total, f"{len(missing)} searches") as advance, site.evaluator(site.search) as evaluator:
                for seed in missing:
                    answer = answer_of_seed(site, evaluator, seed, effort.budget, advance)
                    self.stage(names[seed], lambda answer=answer: answer)
        return [self.stage(names[seed], never) for seed in seeds]

    def draws(
        self, site: Site, variations: Sequence[Variation], mountings: Mountings, judging: str
    ) -> dict[tuple[str, str, str], list[Draw | str]]:
        """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

        By section, what and value, as several draws of one change share them.
        """
        searched = self.landscapes(site, [Job(one, mountings.poses) for one in variations], "the scene varied")
        known = [number for number, found in enumerate(searched) if not isinstance(found, str)]
        rows = {number: [REFERENCE, BASELINE, CANDIDATES + best_candidate(searched[number])] for number in known}
        if judging == HELD_OUT:
            jobs = [
                Job(variations[number], tuple(mountings.poses[row] for row in rows[number]), HELD_OUT)
                for number in known
            ]
            judged = dict(zip(known, self.landscapes(site, jobs, "variations judged"), strict=True))
        else:
            judged = {number: searched[number].select(rows[number]) for number in known}
        draws: dict[tuple[str, str, str], list[Draw | str]] = {}
        for number, (variation, found) in enumerate(zip(variations, searched, strict=True)):
            draw = judged.get(number, found)
            if not isinstance(draw, str):
                draw = Draw(best_candidate(found), chooses(found), draw)
            draws.setdefault((variation.section, variation.what, variation.value), []).append(draw)
        return draws

    def attacks(self, *, quick: bool) -> list[Finding]:
        """Every caster that is installed under every attack."""
        casters, found = attacked_casters(), []
        if not casters:
            return [Finding(CASTERS, "under attack", "", UNDECIDED, "none is installed but the oracle itself")]
        with self.counting(len(ATTACKS), "casters under attack") as advance:
            for name in ATTACKS:

                def count(name=name) -> list[dict]:
                    return [asdict(count_attack(caster, name, quick=quick)) for caster in casters]

                stored = self.stage("_".join(["attack", *name.split()]), count)
                found.append(attack_finding([AttackCount(**one) for one in stored]))
                advance(1)
        return found


def attacked_casters() -> list[str]:
    """The casters that are installed, but for the oracle itself."""
    return [caster for caster in JUDGED if is_available(caster)]
