# Everything of requirements.lock and nothing else:
#   docker build -t lessbench .
#   docker run --rm -it -v "$PWD:/work" lessbench dvc repro
FROM python:3.11-slim
RUN useradd --create-home user
WORKDIR /opt/lessbench
COPY requirements.lock .
RUN python -m pip install --no-cache-dir --no-compile --require-hashes -r requirements.lock
COPY pyproject.toml setup.py README.md LICENSE params.yaml ./
COPY lessbench lessbench
COPY pipeline pipeline
COPY schemas schemas
COPY examples/carry_mug examples/carry_mug
COPY datasets datasets
RUN python -m pip install --no-cache-dir --no-deps --no-build-isolation .
USER user
WORKDIR /work
CMD ["lessbench", "--help"]
