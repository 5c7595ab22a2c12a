"""What accuracy costs: settings of a case or a benchmark, measured against each other."""
