"""The jobs of `reproduce paper`, in the order in which they are started.

figure5/double-01          replanning (Fig. 5)
vanilla/single-01          vanilla search; writes experience
guide/single-without-01    trained on D1 without one assembly; double likewise
guide/single-all           trained on all of D1, for D2
guided/single-01/single    search with the guide of that set
reference/single-01        exact search
orders/single-01           the orders that these searches found, planned again with all effort
"""

from __future__ import annotations

from dataclasses import dataclass

from takeapart.experiments.jobs import Job
from takeapart.experiments.paper_settings import SETS, PaperSettings
from takeapart.experiments.paper_tasks import OrdersTask, ReferenceTask, ReplanningTask, SearchTask, TrainingTask
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly
from takeapart.workcell import Workcell

COST_OF_A_SAMPLE = 0.02  # of training, in planned removals
PHASES = {
    "figure5": "replanning (Fig. 5)",
    "vanilla": "vanilla MCTS",
    "guide": "training",
    "guided": "guided MCTS",
    "reference": "exact search",
    "orders": "orders planned again",
}


@dataclass(frozen=True, eq=False)
class Product:
    """An assembly of one of the data sets.

    Args:
        kind: its data set, "single" or "double".
        number: its place there, from 1; the id in the tables.
        assembly: itself.
    """

    kind: str
    number: int
    assembly: Assembly

    @property
    def name(self) -> str:
        """For names of jobs."""
        return f"{self.kind}-{self.number:02d}"


def load_products(settings: PaperSettings) -> list[Product]:
    """All assemblies of the settings.

    Raises:
        InputError: there is no such file, or it is broken.
    """
    return [
        Product(kind, number, load_assembly(name if name.endswith(".json") else data_path(f"{name}.json")))
        for kind in SETS
        for number, name in enumerate(getattr(settings, kind), 1)
    ]


def guide_of(product: Product, trained_on: str) -> str:
    """Name of the job that trains the guide of an assembly: on all of the other set, or on its own set without it."""
    if trained_on == product.kind:
        return f"guide/{trained_on}-without-{product.number:02d}"
    return f"guide/{trained_on}-all"


def guided_name(product: Product, trained_on: str) -> str:
    """Name of the job of a guided search."""
    return f"guided/{product.name}/{trained_on}"


def guides_for(product: Product) -> list[str]:
    """Sets whose guides are tried on an assembly: Table I has D1, Table II D1 and D2."""
    return ["single"] if product.kind == "single" else ["single", "double"]


def paper_jobs(settings: PaperSettings, products: list[Product]) -> list[Job]:
    """All jobs; each stands after those that it needs."""
    workcell, seed = load_workcell(settings.workcell), settings.seed
    double = [product for product in products if product.kind == "double"]
    jobs = [
        Job(
            f"figure5/{product.name}",
            ReplanningTask(product.assembly, workcell, seed, settings.removal, settings.replans, settings.repeats),
        )
        for product in double[: settings.figure_assemblies]
    ]
    for kind in SETS:
        own = [product for product in products if product.kind == kind]
        vanilla = {product.name: _search(settings, product, workcell, None) for product in own}
        jobs += [Job(f"vanilla/{name}", task) for name, task in vanilla.items()]
        left_out: list[Product | None] = [*own, *([None] if kind == "single" else [])]
        for product in left_out:
            names = [f"vanilla/{other.name}" for other in own if other is not product]
            expected = COST_OF_A_SAMPLE * sum(vanilla[other.name].cost for other in own if other is not product)
            name = f"guide/{kind}-all" if product is None else guide_of(product, kind)
            jobs.append(Job(name, TrainingTask(settings.training, expected), tuple(names)))
        for product in own:
            for trained_on in guides_for(product):
                guide = guide_of(product, trained_on)
                jobs.append(
                    Job(guided_name(product, trained_on), _search(settings, product, workcell, guide), (guide,))
                )
    jobs += [
        Job(
            f"reference/{product.name}",
            ReferenceTask(product.assembly, workcell, seed, settings.reference_queries),
        )
        for product in products
    ]
    for product in products:
        searches = [f"vanilla/{product.name}", *(guided_name(product, kind) for kind in guides_for(product))]
        task = OrdersTask(product.assembly, workcell, seed, settings.order_attempts)
        jobs.append(Job(f"orders/{product.name}", task, (*searches, f"reference/{product.name}")))
    return jobs


def _search(settings: PaperSettings, product: Product, workcell: Workcell, guide: str | None) -> SearchTask:
    return SearchTask(
        product.assembly,
        workcell,
        settings.seed,
        settings.removal,
        settings.mcts,
        settings.episodes,
        settings.queries,
        record=guide is None,
        guide=guide,
    )
