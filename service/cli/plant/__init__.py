"""Commands on a plant as a whole: many machines, robots and campaigns."""
