#!/bin/sh
# The same over TLS: only holders of the key in tls/ can submit work. The certificate is self-signed and valid for 30 days.
#
#     sh docs/cluster/tls.sh etendue run pipelines/smallest.toml
#
# On many machines: make tls/ once, copy it to each securely, and set the variables below wherever scheduler, workers and etendue run.
set -eu
port=${PORT:-8786}
if [ ! -e tls/key.pem ]; then
    mkdir -p tls && chmod 700 tls
    openssl req -x509 -newkey rsa:3072 -nodes -days 30 -subj /CN=etendue -keyout tls/key.pem -out tls/cert.pem 2>tls/openssl.log
fi
export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=true
export DASK_DISTRIBUTED__COMM__TLS__CA_FILE="$PWD/tls/cert.pem"
for who in CLIENT SCHEDULER WORKER; do
    export "DASK_DISTRIBUTED__COMM__TLS__${who}__CERT=$PWD/tls/cert.pem" "DASK_DISTRIBUTED__COMM__TLS__${who}__KEY=$PWD/tls/key.pem"
done
dask scheduler --protocol tls --host 127.0.0.1 --port "$port" --no-dashboard >scheduler.log 2>&1 &
scheduler=$!
dask worker "tls://127.0.0.1:$port" --protocol tls --host 127.0.0.1 --nworkers "${WORKERS:-2}" --nthreads 1 --no-dashboard >workers.log 2>&1 &
workers=$!
trap 'kill $workers $scheduler 2>/dev/null; wait' EXIT
"$@" --scheduler "tls://127.0.0.1:$port"
