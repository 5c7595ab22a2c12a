"""Many runs of one case with varied entries, in processes of their own."""
