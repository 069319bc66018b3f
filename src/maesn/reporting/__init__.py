"""Figures, tables and statistics of finished runs. Reads files; knows no learner and no physics."""
