"""Figures of a test, pages of a campaign, workbooks: what people look at."""
