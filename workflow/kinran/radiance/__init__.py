"""The radiance stack: merged group by group, put together, made coarser, exported."""
