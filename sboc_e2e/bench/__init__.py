"""The benchmark report: scores of whole runs, Monte-Carlo benches of each step, peers in the same run, a baseline to hold."""

from sboc_e2e.bench.run_bench import check_report, run_bench

__all__ = ["check_report", "run_bench"]
