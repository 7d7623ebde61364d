"""DenseSLAM: dense maps in local regions, compared between both estimators."""
