"""The radiance stack: merged group by group, completed, made coarser, exported."""
