# prgbd on the CPU, with the versions that it is tested with. Results are written to the folder that is mounted:
#   docker build --tag prgbd .
#   docker run --rm --volume "$PWD:/work" prgbd python -m prgbd +slam=orb_gtsam +depth=monodepth2 experiment=demo
# The user is number 1000; take --user "$(id -u):$(id -g)" --env HOME=/tmp where your files are another's.
FROM python:3.12-slim AS build
WORKDIR /source
COPY . .
RUN python -m venv /opt/prgbd \
    && /opt/prgbd/bin/pip install --no-cache-dir -c constraints.txt \
       --extra-index-url https://download.pytorch.org/whl/cpu .

FROM python:3.12-slim
COPY --from=build /opt/prgbd /opt/prgbd
ENV PATH=/opt/prgbd/bin:$PATH
RUN useradd --create-home --uid 1000 prgbd && install --directory --owner=prgbd /work
USER prgbd
WORKDIR /work
# A short run leaves the compiled kernels of SLAM in the user's cache, so that no container compiles them again.
RUN python -m prgbd +slam=orb_gtsam +depth=monodepth2 experiment=smoke hydra.run.dir=/tmp/smoke && rm -r /tmp/smoke
CMD ["python", "-m", "prgbd", "--help"]
