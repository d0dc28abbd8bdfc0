"""What everything else is made of: schemas, ids, files. Imported before numpy, it also says which kernels OpenBLAS runs.

OpenBLAS picks its kernels by processor, and theirs differ in the last bit, which contacts of a settling mug carry into the fourth digit of
where it rests. Those of Haswell run on every x86-64 processor with AVX2, so tables are the same bits on all of them.
"""

import os

BLAS_KERNELS = "Haswell"

os.environ.setdefault("OPENBLAS_CORETYPE", BLAS_KERNELS)
