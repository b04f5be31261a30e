"""The paper's evaluation as printed, its error budget on the simulated plant, and a page of both."""

from plugins.commands.reproduction.literal._budget import budget
from plugins.commands.reproduction.literal._evaluation import evaluate, measured_in
from plugins.commands.reproduction.literal._page import write_page

__all__ = ["budget", "evaluate", "measured_in", "write_page"]
