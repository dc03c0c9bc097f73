"""The verdict: three tables that decide from facts, row by row; nothing else names anything or takes a name back.

The first table decides about effects that were fitted to the motion, the second about those that only commands show,
the third about the answer. A row holds where every fact that it asks for is as it says; the first row that holds
decides. Facts are asked for one by one, so that what no row needs is never computed.

``make tables`` writes them into docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar


class Outcome(Enum):
    """What becomes of the effects of one kind, and of what they are to explain."""

    NOTHING = "nothing is wrong"
    NAMED = "they are named"
    SOILS = "the ground differs from recording to recording; no name"
    UNEXPLAINED = "something else acts; no name"


class Verdict(Enum):
    """What a diagnosis comes to."""

    NONE = "none"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"


class Reason(Enum):
    """Why effects that explain the fitted recordings best are not named, or may not be all."""

    NO_REASON = ""
    REFUTED = "held-out recordings are predicted worse with them"
    MINOR = "most of the error in held-out recordings is left with them"
    DOUBT = "far more than noise is left with them, for no known reason"
    BESIDE = "more than noise is left with them"
    LAW = "a force on no list acts beside them"
    VARIES = "they hold on held-out recordings; ground that varies or something else leaves more than noise"


Then = TypeVar("Then", bound=Outcome | Verdict, covariant=True)
Ask = Callable[[str], str]
"""Gives the fact that a question asks for."""


@dataclass(frozen=True)
class Row(Generic[Then]):
    """One row of a table.

    Attributes
    ----------
    when : mapping of str to tuple of str
        Question → facts, any of which will do.
    then : Outcome or Verdict
    reason : Reason
    """

    when: Mapping[str, tuple[str, ...]]
    then: Then
    reason: Reason = Reason.NO_REASON


@dataclass(frozen=True)
class Table(Generic[Then]):
    """Rows, of which the first that holds decides.

    Attributes
    ----------
    title : str
    questions : mapping of str to (str, tuple of str)
        What each question asks in words, and which facts may answer it.
    rows : tuple of Row
    """

    title: str
    questions: Mapping[str, tuple[str, tuple[str, ...]]]
    rows: tuple[Row[Then], ...]

    def first(self, ask: Ask) -> Row[Then]:
        """The first row that holds; every question is asked once at most."""
        known: dict[str, str] = {}
        for row in self.rows:
            if all(self._fact(name, ask, known) in facts for name, facts in row.when.items()):
                return row
        raise ValueError(f"{self.title}: no row for {known}")

    def _fact(self, name: str, ask: Ask, known: dict[str, str]) -> str:
        if name not in known:
            fact = ask(name)
            if fact not in self.questions[name][1]:
                raise ValueError(f"{self.title}: {name} is {fact!r}; expected one of {self.questions[name][1]}")
            known[name] = fact
        return known[name]


_HELD = ("better", "little", "worse")
_NO, _SOME, _NOISE, _MORE, _FAR = ("no",), ("yes",), ("noise",), ("more", "far more"), ("far more",)

MOTION: Table[Outcome] = Table(
    "Effects fitted to the motion",
    {
        "several soils": (
            "does a soil of its own in each recording explain more than the effects, and leave no more than noise?",
            ("no", "instead", "beside"),
        ),
        "effects": ("was any found with enough evidence (and not replaced by soils)?", ("no", "yes")),
        "left": (
            "what is left in positions, headings, rates, angle and torques with them?",
            ("noise", "more", "far more"),
        ),
        "force": (
            (
                "does a force on no list explain it, or as a law more than the effects with no more terms (where "
                "effects were found, only forces that were measured tell)? beside: as a law it leaves noise alone, and "
                "some of them are still needed"
            ),
            ("no", "yes", "beside"),
        ),
        "held out": ("how are held-out recordings predicted with them?", _HELD),
        "forces": ("were torques or a joint's angle measured, in which a force on no list would show?", ("no", "yes")),
        "sure": (
            (
                "do held-out positions or headings surely err less with them, neither of them more, and are held-out "
                "windows surely likelier with them where the ground may vary in either model?"
            ),
            ("no", "yes"),
        ),
        "left without": ("what is left without any effect?", ("noise", "more", "far more")),
    },
    (
        Row({"several soils": ("instead",)}, Outcome.SOILS),
        Row({"effects": _NO, "left": _NOISE}, Outcome.NOTHING),
        Row({"effects": _NO}, Outcome.UNEXPLAINED),
        Row(
            {"several soils": _NO, "left": _MORE, "forces": _NO, "held out": ("better", "little"), "sure": _SOME},
            Outcome.NAMED,
            Reason.VARIES,
        ),
        Row(
            {"several soils": _NO, "force": ("beside",), "held out": ("better",)},
            Outcome.NAMED,
            Reason.LAW,
        ),
        Row({"several soils": _NO, "force": ("yes", "beside")}, Outcome.UNEXPLAINED),
        Row({"held out": ("worse",), "left without": _NOISE}, Outcome.NOTHING, Reason.REFUTED),
        Row({"held out": ("worse",)}, Outcome.UNEXPLAINED, Reason.REFUTED),
        Row({"held out": ("little",), "left without": _NOISE}, Outcome.NOTHING, Reason.MINOR),
        Row({"held out": ("little",)}, Outcome.UNEXPLAINED, Reason.MINOR),
        Row({"several soils": _NO, "left": _FAR}, Outcome.UNEXPLAINED, Reason.DOUBT),
        Row({"several soils": _NO, "left": _MORE}, Outcome.NAMED, Reason.BESIDE),
        Row({}, Outcome.NAMED),
    ),
)

COMMANDS: Table[Outcome] = Table(
    "Effects that only commands show",
    {
        "followed": (
            "do the front motors follow their commands, and if not, may these be the commands that they were given?",
            ("not commanded", "not theirs", "no", "yes"),
        ),
        "effects": ("was any found with enough evidence?", ("no", "yes")),
        "left": ("what is left in the front motors' speeds with all that is named?", ("noise", "more")),
        "share": ("how much of what is left without any effect is left with them?", ("little", "most")),
        "held out": ("how are held-out recordings predicted with them?", _HELD),
        "left without": ("what is left in the front motors' speeds without them?", ("noise", "more")),
    },
    (
        Row({"followed": ("not commanded", "not theirs")}, Outcome.NOTHING),
        Row({"followed": _NO}, Outcome.UNEXPLAINED),
        Row({"effects": _NO, "left": _NOISE}, Outcome.NOTHING),
        Row({"effects": _NO}, Outcome.UNEXPLAINED),
        Row({"held out": ("worse",), "left without": _NOISE}, Outcome.NOTHING, Reason.REFUTED),
        Row({"held out": ("worse",)}, Outcome.UNEXPLAINED, Reason.REFUTED),
        Row({"left": ("more",), "share": ("most",)}, Outcome.UNEXPLAINED, Reason.DOUBT),
        Row({"left": ("more",)}, Outcome.NAMED, Reason.BESIDE),
        Row({}, Outcome.NAMED),
    ),
)


def _outcomes(*outcomes: Outcome) -> tuple[str, ...]:
    return tuple(outcome.name.lower() for outcome in outcomes)


_ALL = _outcomes(*Outcome)

VERDICT: Table[Verdict] = Table(
    "The answer",
    {
        "motion": ("what became of the effects fitted to the motion?", _ALL),
        "commands": ("what became of the effects that only commands show?", _ALL),
        "encoders": (
            "do recorded angles show a low-pass on the speeds that are recorded beside them?",
            ("nothing", "named"),
        ),
        "tie": ("does another effect explain as much as the named one with the most evidence?", ("no", "yes")),
    },
    (
        Row({"motion": _outcomes(Outcome.UNEXPLAINED)}, Verdict.UNEXPLAINED),
        Row(
            {
                "motion": _outcomes(Outcome.SOILS),
                "commands": _outcomes(Outcome.NOTHING, Outcome.UNEXPLAINED),
            },
            Verdict.UNEXPLAINED,
        ),
        Row({"motion": _outcomes(Outcome.NOTHING), "commands": _outcomes(Outcome.UNEXPLAINED)}, Verdict.UNEXPLAINED),
        Row(
            {
                "motion": _outcomes(Outcome.NOTHING),
                "commands": _outcomes(Outcome.NOTHING),
                "encoders": ("nothing",),
            },
            Verdict.NONE,
        ),
        Row({"tie": _SOME}, Verdict.AMBIGUOUS),
        Row({}, Verdict.NAMED),
    ),
)

TABLES: tuple[Table[Outcome | Verdict], ...] = (MOTION, COMMANDS, VERDICT)


def as_markdown(tables: Sequence[Table[Outcome | Verdict]] = TABLES) -> str:
    """The tables for the docs; an empty cell asks nothing."""
    lines: list[str] = []
    for table in tables:
        lines += [f"**{table.title}**", ""]
        lines += [f"- *{name}*: {words}" for name, (words, _) in table.questions.items()]
        names = list(table.questions)
        lines += ["", f"| {' | '.join(['', *names, 'then', 'because'])} |", "|" + "---|" * (len(names) + 3)]
        for number, row in enumerate(table.rows, 1):
            cells = [" or ".join(row.when.get(name, ())) for name in names]
            lines.append(f"| {' | '.join([str(number), *cells, _words(row.then), row.reason.value])} |")
        lines.append("")
    return "\n".join(lines).replace("|  |", "| |").replace("|  |", "| |")


def _words(then: Outcome | Verdict) -> str:
    return f"`{then.value}`" if isinstance(then, Verdict) else f"{then.name.lower()}: {then.value}"
