"""Columns and captions that several tables share."""

from __future__ import annotations

from report.formats import fixed, significant
from report.table import Column

PSNR = Column("psnr", "PSNR", fixed(2), "higher")
SSIM = Column("ssim", "SSIM", fixed(3), "higher")
LPIPS = Column("lpips", "LPIPS", fixed(3), "lower")
FLIP = Column("flip", "FLIP", fixed(3), "lower")
HDR_FLIP = Column("flip_hdr", "HDR-FLIP", fixed(3), "lower")
RELMSE = Column("relmse", "relMSE", significant(2), "lower")
STORAGE = Column("storage_mb", "Storage, MB", significant(3), "lower", rank_zero=False)
MEMORY = Column("memory_mb", "Peak memory, MB", significant(3), "lower")
PREPARATION = Column("prepare_seconds", "Preparation, s", significant(3))
SECONDS = Column("seconds_per_view", "Seconds per view", significant(3), "lower")

QUALITY = (PSNR, SSIM, LPIPS, FLIP, HDR_FLIP, RELMSE)

PAPER = "In brackets: what the paper reports."
BEST = "Best in bold, second best underlined."
NO_COSTS = "no cost file"
