"""Figures, tables and statistics of finished runs. Reads files; knows no learner and no physics."""

from maesn.report.tables import print_adaptation_summary as print_adaptation_summary
