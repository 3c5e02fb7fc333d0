# The two commands of the README without an installation on the host:
#   docker build -t sboc .
#   docker run --rm -v "$PWD/runs:/home/sboc/e2e/runs" sboc                            # make e2e SCENARIO=smoke
#   docker run --rm -v "$PWD/runs:/home/sboc/e2e/runs" sboc e2e SCENARIO=sso_antisun
#   docker run --rm -v "$PWD/out:/home/sboc/e2e/bench/out" sboc bench
# Any target of the Makefile but `docs` works in this way. The mounted folder must be writable for user 1000, or
# add `--user "$(id -u)"`. No compiler is needed: packages come as wheels, and one is built from
# its Python sources. Tests of the report in a browser are skipped here, because the image has no Chromium.
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends make && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home --uid 1000 sboc
USER sboc
WORKDIR /home/sboc/e2e
# The packages change less often than the sources: they have a layer of their own.
COPY --chown=sboc requirements.lock requirements-run.lock ./
RUN python -m venv .venv && .venv/bin/python -m pip install --no-cache-dir --no-compile --require-hashes -r requirements.lock
COPY --chown=sboc . .
# The rest of the set-up. Kernels are compiled while the image is made, for the processor of the machine that makes it.
ENV NUMBA_CACHE_DIR=/home/sboc/kernels HOME=/home/sboc
RUN make .venv/.tools .venv/.kernels && mkdir -p runs bench/out && chmod -R a+rwX /home/sboc
ENTRYPOINT ["make"]
CMD ["e2e", "SCENARIO=smoke"]
