"""What another engine says of executions: PyBullet and MuJoCo with the same rigid pads, candidate by candidate. SECOND_ENGINE.md beside.

```python
for one in choose(release.table("candidates"), seed):  # 150, with the weight of each
    row = opinion(object_model, candidate, motion, recipe.execution_setup)  # pure; 2 s
summary(rows, {one.candidate_id: one.weight for one in chosen})
```
"""

from pipelines.proofs.validity.second_engine.both_engines import opinion
from pipelines.proofs.validity.second_engine.sample import Chosen, choose, confusion, summary

__all__ = ["Chosen", "choose", "confusion", "opinion", "summary"]
