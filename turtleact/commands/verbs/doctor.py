"""Declares the verb ``doctor`` for Typer."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import SETTINGS, Job, Verb
from turtleact.commands.verbs.options import Config, Connect, Domain, Interfaces, folder, reach

__all__ = ["app", "doctor"]

AsJson: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print a line of JSON for each fault.")
]
Verbose: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Print facts too: routers, versions, sessions, domains in use."
    ),
]

app = typer.Typer(**SETTINGS)


@app.command(cls=Verb, help=VERBS["doctor"])
def doctor(
    *,
    as_json: AsJson = False,
    verbose: Verbose = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``doctor``."""
    where = reach(connect, domain, config)

    def job() -> int:
        from turtleact.commands import doctor
        from turtleact.commands.interfaces import make_known

        make_known(folder(interfaces))
        return doctor.run(where, as_json=as_json, verbose=verbose)

    return job
