# sweepid with what it needs, and nothing to build with. BASE: any image of a Debian with Python >= 3.11 and venv.
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS build
WORKDIR /build
COPY requirements.lock ./
# uv is in the lock as well
RUN python3 -m venv /tools \
 && sed -n '/^uv==/,/[^\\]$/p' requirements.lock > uv.lock \
 && /tools/bin/pip install --no-cache-dir --disable-pip-version-check --require-hashes --requirement uv.lock \
 && python3 -m venv --without-pip /opt/sweepid
# compiled here, for whoever runs it may not write
ENV VIRTUAL_ENV=/opt/sweepid UV_NO_CACHE=1 UV_COMPILE_BYTECODE=1
COPY pyproject.toml ./
# versions and hashes from the lock, but only what the product itself needs
RUN /tools/bin/uv pip install --constraint requirements.lock --extra dask --extra postgresql --extra s3 --requirement pyproject.toml
COPY README.md LICENSE ./
COPY drivers drivers
COPY service service
COPY simulator simulator
COPY sweepid sweepid
RUN /tools/bin/uv pip install --no-deps --build-constraint requirements.lock .

FROM ${BASE}
RUN useradd --uid 10001 --no-create-home --shell /usr/sbin/nologin sweepid && install --directory --owner sweepid /data
COPY --from=build /opt/sweepid /opt/sweepid
WORKDIR /app
COPY config config
USER sweepid
ENV PATH=/opt/sweepid/bin:${PATH} SWEEPID_DATA_DIR=/data
# `serve` listens on loopback; `serve --host 0.0.0.0` wants SWEEPID_LOGIN=true, or SWEEPID_TRUSTED_NETWORK=true where the
# port is published to this computer alone (docs/how-to/let-others-in.md)
ENTRYPOINT ["sweepid"]
