# The two commands of the README without an installation:
#   docker build -t sboc . && docker run --rm -v "$PWD/runs:/runs" sboc run smoke --out /runs/smoke --force
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*
ENV OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 NUMBA_CACHE_DIR=/opt/kernels
WORKDIR /opt/sboc
COPY requirements.lock .
RUN python -m pip install --no-cache-dir --require-hashes -r requirements.lock
COPY . .
# Kernels are compiled while the image is made, so that the first run does not wait for them.
RUN python -m pip install --no-cache-dir --no-deps -e . && python -m sboc_e2e.warm_up && chmod -R a+rwX /opt/kernels
WORKDIR /runs
ENTRYPOINT ["sboc"]
CMD ["run", "smoke", "--out", "/runs/smoke", "--force"]
