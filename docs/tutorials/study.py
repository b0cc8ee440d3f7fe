# %% file
from pathlib import Path
from tempfile import mkdtemp

folder = Path(mkdtemp())
(folder / "weights.toml").write_text("""
seeds = 4
estimators = ["graph"]

[simulate]
world = "book"
clean = true

[options]
edges = "virtual+motion"

[options.vary]
weight = ["pairs", "tempered", "marginal"]
""")

# %% plan
import comparisons

study = comparisons.read_study(folder / "weights.toml")
print(len(study.runs), "runs")
assert len(study.runs) == 3 * 4  # weights times seeds

# %% sweep
outcome = comparisons.sweep(study, jobs=1)
print(f"{outcome.ran} runs, {outcome.failed} of them failed")
assert outcome.failed == 0

# %% summary
summary = comparisons.summarise(study.database)
for method in summary.methods:
    print(f"{method.method:24} median ATE {method.figures['ate_m'].median:.3f} m over {method.runs} runs")
for pair in summary.differences:
    print(f"{pair.method:24} lower than {pair.baseline} on {pair.lower['ate_m']} of 4 logs")
assert [method.runs for method in summary.methods] == [4, 4, 4]

# %% picture
summary.figure()
